//! Models that a scene places among other things: each file is read once, however often it stands there.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::{Model, NOTHING_TO_SHOW, Names, Standing, has_materials};
use crate::scene::error::quoted;
use crate::scene::files::within_folder;
use crate::scene::mesh::Placement;
use crate::scene::texture::check_sum;
use crate::scene::validate::MOST_SEEN;
use crate::scene::{Material, SceneWarning, Shape, Texture};

/// The files that a scene has named so far, and what of the scene they add to. In all of it, `Err` says what is wrong and the
/// remedy, without the file's name.
pub(in crate::scene) struct PlacedModels<'a> {
    folder: Option<&'a Path>,
    materials: &'a mut Vec<Material>,
    /// Theirs.
    names: Names,
    textures: &'a mut Vec<Texture>,
    /// Numbers of files by where they lie.
    numbers: BTreeMap<PathBuf, usize>,
    /// How often the scene places each, smooth or not.
    times: BTreeMap<(PathBuf, bool), usize>,
    /// Triangles placed so far, each instance counted.
    seen: u64,
    read: Vec<ReadModel>,
}

struct ReadModel {
    /// As the scene called it first.
    file: String,
    has_materials: bool,
    model: Model,
    /// Whether each of its materials shines.
    emits: Vec<bool>,
    /// Where it lies.
    path: PathBuf,
    /// The number of its first material, once the scene has taken them.
    first: Option<usize>,
}

impl<'a> PlacedModels<'a> {
    /// None yet, in this folder, for a scene of these materials and textures.
    pub fn new(
        folder: Option<&'a Path>,
        materials: &'a mut Vec<Material>,
        textures: &'a mut Vec<Texture>,
    ) -> Self {
        let names = Names::of(materials.iter().map(|material| material.name.as_str()));
        let (numbers, times, read) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
        PlacedModels { folder, materials, names, textures, numbers, times, seen: 0, read }
    }

    /// Tells beforehand that the scene is going to place that file, so that it may share what it places often.
    pub fn announce(&mut self, file: &str, smooth: bool) {
        if let Ok(path) = within_folder(self.folder, file) {
            *self.times.entry((path, smooth)).or_default() += 1;
        }
    }

    /// The number of the file of that name, which must lie within the folder; read if it is new.
    pub fn number(&mut self, file: &str) -> Result<usize, String> {
        let path = within_folder(self.folder, file)?;
        if let Some(&number) = self.numbers.get(&path) {
            return Ok(number);
        }
        let (number, has_materials) = (self.read.len(), has_materials(&path));
        let model = Model::load(&path)?;
        let emits = model.materials.iter().map(Material::is_emissive).collect();
        let file = file.to_owned();
        self.read.push(ReadModel { file, has_materials, model, emits, path: path.clone(), first: None });
        self.numbers.insert(path, number);
        Ok(number)
    }

    /// Whether the file may have materials of its own.
    pub fn has_materials(&self, number: usize) -> bool {
        self.read[number].has_materials
    }

    /// Whether all of its surfaces have normals.
    pub fn has_normals(&self, number: usize) -> bool {
        self.read[number].model.surfaces.iter().all(|surface| !surface.data.normals.is_empty())
    }

    /// Its surfaces, placed so, one at least; smooth if they have normals and are to be. Materials are numbers of the file's;
    /// `material` is that of the scene which they get instead, if they do.
    pub fn place(
        &mut self,
        number: usize,
        placement: &Placement,
        smooth: bool,
        material: Option<usize>,
    ) -> Result<Vec<Shape>, String> {
        let ReadModel { model, emits, path, .. } = &mut self.read[number];
        let times = self.times.get(&(path.clone(), smooth)).copied().unwrap_or(1);
        let shines = material.map(|material| self.materials[material].is_emissive());
        let emits = |own: usize| shines.unwrap_or(emits[own]);
        // Before any is placed: that takes time for each triangle.
        self.seen = self.seen.saturating_add(model.seen());
        let planned = model.seen().saturating_mul(times as u64).max(self.seen);
        if planned > MOST_SEEN {
            return Err(format!(
                "brings the scene to {planned} triangles, each instance counted; stay within {MOST_SEEN}, with fewer instances"
            ));
        }
        let shapes = model.place(&Standing { placement, smooth, times, emits: &emits })?;
        match shapes.is_empty() {
            true => Err(NOTHING_TO_SHOW.to_owned()),
            false => Ok(shapes),
        }
    }

    /// The number that its first material has in the scene. They are added once, under names that no other has, and their
    /// textures.
    pub fn first_material(&mut self, number: usize) -> Result<usize, String> {
        let ReadModel { file, model, first, .. } = &mut self.read[number];
        if let Some(first) = *first {
            return Ok(first);
        }
        let (place, first_texture) = (self.materials.len(), self.textures.len());
        self.textures.append(&mut model.textures);
        check_sum(self.textures)?;
        for mut material in std::mem::take(&mut model.materials) {
            material.textures.move_by(first_texture);
            let name = self.names.fresh(format!("{file}: {}", material.name));
            self.materials.push(Material { name, ..material });
        }
        *first = Some(place);
        Ok(place)
    }

    /// What was odd about the files.
    pub fn warnings(self) -> Vec<SceneWarning> {
        self.read.into_iter().flat_map(|read| warnings(read.model, &read.file)).collect()
    }
}

/// What was odd about a file, and what of it a scene does not take.
fn warnings(mut model: Model, file: &str) -> Vec<SceneWarning> {
    let Model { cameras, lamps, findings, .. } = &mut model;
    for camera in cameras {
        let name = format_args!("camera {}", quoted(&camera.name));
        findings.note("not taken over; the scene has its own", name);
    }
    for lamp in lamps {
        findings.note("a light without a surface, not taken over; add a shape that emits", &lamp.name);
    }
    findings.warnings(file)
}
