//! Levels held still for benches/stages.rs.

use crate::support::*;
use qtracer::RenderOptions;
use qtracer::engine::RecordedLevel;
use qtracer::gpu::stage::Schedule;
use std::collections::BTreeMap;

/// A stage run again on recorded queues does the same again, and the queues hold what the stages hand on.
#[test]
fn recorded_levels_can_be_run_again() {
    let scene = scene("bansal-room-1");
    let adapter = adapter();
    for schedule in [Schedule::Fused, Schedule::Streamed, Schedule::Compacted] {
        let options = RenderOptions {
            size: Some((24, 16)),
            schedule: Some(schedule),
            adapter: adapter.clone(),
            ..Default::default()
        };
        let mut recorded = RecordedLevel::record(&scene, &options, 2).unwrap();
        let mut items = BTreeMap::new();
        while let Some(stage) = recorded.stage() {
            for _ in 0..2 {
                assert!(recorded.run().unwrap() >= 0.0);
            }
            items.insert(stage.name.clone(), stage.items);
            recorded.advance().unwrap();
        }
        assert!(items["resolve"] > 0, "{items:?}");
        if schedule == Schedule::Fused {
            assert!(items["step"] > 0, "{items:?}");
            continue;
        }
        // A closed room: every ray hits something of one of its materials.
        let shaded: u64 = items.iter().filter(|(name, _)| name.starts_with("shade_")).map(|(_, n)| n).sum();
        assert!(shaded > 0 && shaded == items["intersect"], "{items:?}");
    }
}
