use super::*;
use crate::guiding::lessons::VISIT_UNIT;
use crate::guiding::table::adaptive;
use crate::guiding::{LessonLayout, Lessons};
use glam::{Vec2, Vec3};
use proptest::prelude::*;

/// Random numbers that need no state elsewhere.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }
}

/// A learner after some lessons: cells that were cut, quadtrees where the mode has them.
fn learner(mode: GuideMode, seed: u64) -> Learner {
    let options = GuideOptions { mode, cell_size: Some(4.0), depth: 3, ..Default::default() };
    let mut learner = Learner::new(options, Vec3::splat(-3.0), Vec3::splat(3.0), 10.0).unwrap();
    learner.set_scene(seed ^ 0xabcd);
    let mut numbers = Numbers(seed);
    let base = learner.layout().missing;
    learner.make_cells(&(0..base).map(|_| numbers.next().is_multiple_of(5) as u32).collect::<Vec<_>>());
    for _ in 0..4 {
        let table = learner.table(true, &[]);
        let layout = LessonLayout::new(&table.uniforms);
        let value = |numbers: &mut Numbers| match numbers.next() % 4 {
            0 => 0,
            1 => numbers.next() << 8,
            _ => numbers.next(),
        };
        // Some cells are met so often that they are cut.
        let visit = |numbers: &mut Numbers| match numbers.next() % 64 {
            0 => VISIT_UNIT as u64 * 10_000_000,
            _ => VISIT_UNIT as u64 * (numbers.next() % 400),
        };
        let lessons = Lessons {
            values: (0..layout.slots).map(|_| value(&mut numbers)).collect(),
            visits: (0..layout.visits).map(|_| visit(&mut numbers)).collect(),
            missing: vec![0; layout.missing as usize],
        };
        learner.learn(&lessons, 1);
    }
    learner
}

/// The same, as far as files know.
fn same(a: &Learner, b: &Learner) -> bool {
    a.to_bytes() == b.to_bytes()
}

fn fault(bytes: &[u8]) -> String {
    match from_bytes(bytes) {
        Err(Fault::Damaged(reason)) => reason,
        Err(Fault::Newer(version)) => format!("version {version}"),
        Ok(_) => "nothing".to_string(),
    }
}

/// With the checksum that belongs to them: what a forger or a faulty writer would leave.
fn stamped(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len() - 8;
    let checksum = fnv1a([&bytes[..end]]);
    bytes[end..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

#[test]
fn what_was_learnt_comes_back_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("learnt.guide");
    for mode in MODES {
        let before = learner(mode, 7);
        before.save(&path).unwrap();
        let after = Learner::load(&path).unwrap();
        assert!(same(&before, &after), "{mode}");
        assert_eq!((after.mode(), after.cells(), after.nodes()), (mode, before.cells(), before.nodes()));
        assert_eq!((after.passes(), after.samples(), after.scene()), (4, 4, 7 ^ 0xabcd));
        let unit = fixed_point_unit(10.0);
        let resumed = after.resumed(*before.options(), 10.0).unwrap();
        let (table, expected) = (resumed.table(true, &[0.5]), before.clone().table(true, &[0.5]));
        assert_eq!((table.uniforms, table.rows), (expected.uniforms, expected.rows));
        assert_eq!(table.uniforms.unit, unit);
    }
    let adaptive = learner(GuideMode::Adaptive, 7);
    assert!(adaptive.nodes() > 50 && adaptive.index.iter().any(|&word| word != NO_CELL && word & FINER != 0));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_learner_goes_on_only_with_its_mode_and_enough_memory() {
    let learner = learner(GuideMode::Octant, 3);
    let options = *learner.options();
    let wanted = GuideMode::Adaptive;
    let error = learner.resumed(GuideOptions { mode: wanted, ..options }, 1.0).unwrap_err();
    assert_eq!(error, LearnerError::Mode { learnt: GuideMode::Octant, wanted });
    let error = learner.resumed(GuideOptions { memory: 100, ..options }, 1.0).unwrap_err();
    assert_eq!(error, LearnerError::LearntMemory { bytes: learner.bytes(), limit: 100 });
}

#[test]
fn bytes_are_those_of_the_buffers() {
    for mode in MODES {
        let learner = learner(mode, 11);
        let table = learner.snapshot();
        assert_eq!(learner.bytes(), learner.table_bytes() + learner.sums_bytes() + learner.state_bytes());
        let state = &learner.state;
        let known = size_of_val(&*state.cells) + size_of_val(&*state.nodes);
        let shapes = size_of_val(&*state.trees) + size_of_val(&*state.children);
        let met = if mode == GuideMode::Adaptive { 32 * learner.cells() } else { 0 };
        assert_eq!(learner.state_bytes(), (known + shapes + met) as u64, "{mode}");
        let rows = learner.table_bytes().div_ceil(16);
        assert_eq!(rows, table.rows.len() as u64, "{mode}");
        assert_eq!(learner.sums_bytes(), 4 * LessonLayout::new(&table.uniforms).words(), "{mode}");
    }
}

#[test]
fn every_damage_is_named() {
    let good = learner(GuideMode::Adaptive, 5).to_bytes();
    let with = |at: usize, bytes: &[u8]| {
        let mut changed = good.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        changed
    };
    assert!(fault(b"").contains("no file of what a guide has learnt"));
    assert!(fault(&with(0, b"PNG")).contains("no file of what a guide has learnt"));
    assert!(fault(&good[..10]).contains("ends too early"));
    assert!(fault(&good[..good.len() - 3]).contains("checksum"));
    assert!(fault(&with(200, &[1, 2, 3, 4])).contains("checksum"));
    assert_eq!(fault(&with(8, &[2, 0, 0, 0])), "version 2");
    assert!(fault(&with(8, &[0; 4])).contains("no version"));
    // A header of 68 bytes, then the index: its name, its length, its words.
    let stamp = |at: usize, bytes: &[u8]| fault(&stamped(with(at, bytes)));
    assert!(stamp(12, &[9, 0, 0, 0]).contains("unknown kind of guide, 9"));
    assert!(stamp(36, &f32::NAN.to_le_bytes()).contains("grid"));
    assert!(stamp(48, &0.0f32.to_le_bytes()).contains("grid"));
    assert!(stamp(56, &[255; 4]).contains("index does not fit"));
    assert!(stamp(68, &[3, 0, 0, 0]).contains("grid"));
    assert!(stamp(72, b"XXXX").contains("INDX is missing"));
    assert!(stamp(76, &[255; 8]).contains("says that it has"));
    assert!(stamp(84, &[0, 0, 0, 128]).contains("astray"));
    assert!(stamp(84, &[0, 0, 0, 64]).contains("cell"));
    let cells = good.windows(4).position(|w| w == b"CELL").unwrap() + 12;
    assert!(stamp(cells, &(-1.0f32).to_le_bytes()).contains("energies"));
    assert!(stamp(cells + 4, &f32::INFINITY.to_le_bytes()).contains("energies"));
    assert!(stamp(cells + 64, &[0, 1, 0, 0]).contains("quadtrees"));
    assert!(stamp(cells + 68, &[9, 0, 0, 0]).contains("not where it says"));
    assert!(
        stamp(cells + 72, &[255; 4]).contains("nodes") || stamp(cells + 72, &[255; 4]).contains("quadtrees")
    );
    let mut longer = good.clone();
    longer.splice(good.len() - 8..good.len() - 8, [0; 4]);
    assert!(fault(&stamped(longer)).contains("4 bytes follow"));
}

/// Only the adaptive guide cuts cells, and kernels of the others look for no finer ones.
#[test]
fn finer_cells_are_refused_where_a_guide_makes_none() {
    let mut cut = learner(GuideMode::Octant, 5);
    let (word, block) = (cut.state.trees[0].row as usize, cut.index.len() as u32);
    cut.index[word] = FINER | block;
    cut.index.extend([0; 8]);
    (cut.state.trees[0].row, cut.levels[0]) = (block, 1);
    assert!(fault(&cut.to_bytes()).contains("finer cells"), "{}", fault(&cut.to_bytes()));
}

#[test]
fn files_that_cannot_be_read_or_written_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.guide");
    let message = Learner::load(&path).unwrap_err().to_string();
    assert!(message.contains("x.guide") && message.contains("check the name"), "{message}");
    assert!(Learner::load(folder.path()).unwrap_err().to_string().contains("no regular file"));
    std::fs::write(&path, b"QTGUIDE\n\x09\0\0\0").unwrap();
    let message = Learner::load(&path).unwrap_err().to_string();
    assert!(message.contains("version 9") && message.contains("newer qtracer"), "{message}");
    let message = Learner::check_writable(&folder.path().join("no/x")).unwrap_err().to_string();
    assert!(message.contains("does not exist"), "{message}");
}

/// Uses all of a table that was read.
fn exercise(learner: &Learner) {
    let mut learner = learner.clone();
    let table = learner.table(true, &[]);
    let mut numbers = Numbers(1);
    for _ in 0..200 {
        let [x, y, z] = [0; 3].map(|_| (numbers.next() % 1000) as f32 / 500.0 - 1.0);
        let direction = Vec3::new(x, y, z + 1e-3).normalize();
        let place = table.place(5.0 * Vec3::new(z, x, y), direction);
        if place.cell != NO_CELL && learner.mode() == GuideMode::Adaptive {
            let cell = table.cell(place.row);
            adaptive::density(&table, &cell, direction);
            adaptive::sample(&table, &cell, Vec2::new(0.5 * (x + 1.0), 0.4));
        }
    }
    let layout = learner.layout();
    learner.learn(
        &Lessons {
            values: vec![1 << 20; layout.slots as usize],
            visits: vec![VISIT_UNIT as u64; layout.visits as usize],
            missing: vec![1; layout.missing as usize],
        },
        1,
    );
    learner.table(true, &[]);
}

proptest! {
    #[test]
    fn flipped_and_cut_bytes_are_an_error_or_change_nothing(
        seed in 0u64..4,
        mode in 0usize..4,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        keep in prop::option::weighted(0.3, any::<prop::sample::Index>()),
    ) {
        let before = learner(MODES[mode], seed);
        let mut bytes = before.to_bytes();
        for (at, bits) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= bits;
        }
        if let Some(keep) = keep {
            bytes.truncate(keep.index(bytes.len() + 1));
        }
        if let Ok(after) = from_bytes(&bytes) {
            prop_assert!(same(&before, &after));
        }
    }

    #[test]
    fn whatever_passes_the_checks_can_be_used(
        seed in 0u64..4,
        mode in 0usize..4,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..3),
        whole_word in any::<bool>(),
    ) {
        let mut bytes = learner(MODES[mode], seed).to_bytes();
        for (at, bits) in flips {
            let at = at.index(bytes.len() - 8);
            match whole_word {
                true => bytes[at & !3] = bits % 16,
                false => bytes[at] ^= bits,
            }
        }
        if let Ok(after) = from_bytes(&stamped(bytes)) {
            exercise(&after);
        }
    }
}
