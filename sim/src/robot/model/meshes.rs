//! Mesh assets. A file is read when a shape needs it.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::super::document::{Classes, Element};
use super::super::folder::Folder;
use super::super::frame::{Frame, normalized};
use super::super::inertia::Solid;
use super::super::mesh::{Mesh, Volume};
use super::blockers::Blockers;
use super::options::Options;
use crate::scene::Hull;

const KNOWN: [&str; 16] = [
    "name",
    "class",
    "file",
    "scale",
    "inertia",
    "vertex",
    "face",
    "normal",
    "texcoord",
    "refpos",
    "refquat",
    "smoothnormal",
    "maxhullvert",
    "content_type",
    "material",
    "octree_maxdepth",
];

/// The meshes of a document, by name.
pub(super) struct Meshes {
    assets: BTreeMap<String, Asset>,
    pub(super) files: Files,
}

/// Where the files of meshes and height fields are.
pub(super) struct Files {
    folder: String,
    /// Whether only the name at the end of a path counts.
    strips_paths: bool,
}

impl Files {
    /// Path and content of the file that an element names, if it names one.
    pub(super) fn read(
        &self,
        element: &Element,
        folder: &mut Folder<'_>,
    ) -> Result<Option<(String, Vec<u8>)>, String> {
        let Some(file) = element.text("file") else { return Ok(None) };
        let file = if self.strips_paths { name_of(file) } else { file };
        let read = folder.read(&self.folder, file, element.file());
        read.map(Some).map_err(|reason| element.refuse(reason))
    }
}

struct Asset {
    element: Element,
    /// The mesh with its hull, once a shape needs it.
    loaded: Option<(Mesh, Arc<Hull>)>,
}

impl Meshes {
    pub(super) fn read(
        root: &Element,
        classes: &Classes,
        options: &Options,
        blockers: &Blockers,
    ) -> Self {
        let mut assets = BTreeMap::new();
        for element in root.all("asset").flat_map(|section| section.all("mesh")) {
            let resolved = blockers.keep(classes.resolve(element, None));
            let asset =
                Asset { element: resolved.unwrap_or_else(|| element.alone()), loaded: None };
            blockers.keep(insert(&mut assets, element, asset));
        }
        let (folder, strips_paths) = (options.mesh_folder.clone(), options.strips_paths);
        Self { assets, files: Files { folder, strips_paths } }
    }

    /// Convex hull of the mesh that a shape names.
    pub(super) fn hull(
        &mut self,
        geom: &Element,
        folder: &mut Folder<'_>,
    ) -> Result<Arc<Hull>, String> {
        let name = geom.text("mesh").ok_or_else(|| geom.refuse("it names no `mesh`; add one"))?;
        if !self.assets.contains_key(name) {
            let known = self.assets.keys().map(String::as_str);
            return Err(geom.refuse_name("mesh", "mesh", known));
        }
        let asset = self.assets.get_mut(name);
        let asset = asset.ok_or_else(|| geom.refuse("its mesh is not loaded"))?;
        if let Some((_, hull)) = &asset.loaded {
            return Ok(Arc::clone(hull));
        }
        let mesh = asset.load(&self.files, folder)?;
        let hull = mesh.hull().map_err(|reason| asset.element.refuse(reason))?;
        let (_, hull) = asset.loaded.insert((mesh, Arc::new(hull)));
        Ok(Arc::clone(hull))
    }

    /// Number of the meshes whose hulls have more corners than their `maxhullvert`.
    pub(super) fn beyond_limit(&self) -> usize {
        let hulls =
            self.assets.values().filter_map(|asset| Some((asset, &asset.loaded.as_ref()?.1)));
        let is_beyond = |(asset, hull): &(&Asset, &Arc<Hull>)| {
            let limit = asset.element.integer("maxhullvert", -1);
            limit.is_ok_and(|most| most >= 0 && hull.points.len() > most as usize)
        };
        hulls.filter(is_beyond).count()
    }

    /// Mass properties of the mesh that a shape names, with a density of 1 kg/m^3.
    pub(super) fn solid(&self, geom: &Element, hull: &Arc<Hull>) -> Result<Solid, String> {
        let asset = geom.text("mesh").and_then(|name| self.assets.get(name));
        let Some((asset, Some((mesh, _)))) = asset.map(|asset| (asset, &asset.loaded)) else {
            return Err(geom.refuse("its mesh is not loaded"));
        };
        let volumes = [
            ("legacy", Volume::Legacy),
            ("exact", Volume::Exact),
            ("convex", Volume::Convex),
            ("shell", Volume::Shell),
        ];
        let volume = asset.element.word("inertia", &volumes)?;
        mesh.solid_of(volume, hull).map_err(|reason| asset.element.refuse(reason))
    }
}

/// Adds a mesh or height field under its name.
pub(super) fn insert<T>(
    assets: &mut BTreeMap<String, T>,
    element: &Element,
    asset: T,
) -> Result<(), String> {
    let name = asset_name(element);
    if name.is_empty() {
        return Err(element.refuse("it has neither a name nor a file; state one"));
    }
    match assets.insert(name, asset) {
        None => Ok(()),
        Some(_) => Err(element.refuse("another one has the same name; rename one")),
    }
}

/// Name of a mesh or height field, which is that of its file unless stated; empty without both.
pub(super) fn asset_name(asset: &Element) -> String {
    let stem = asset.text("file").map(name_of);
    let stem = stem.map(|file| file.rsplit_once('.').map_or(file, |(stem, _)| stem));
    asset.text("name").or(stem).unwrap_or_default().to_owned()
}

fn name_of(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

impl Asset {
    fn load(&self, files: &Files, folder: &mut Folder<'_>) -> Result<Mesh, String> {
        let element = &self.element;
        if element.text("builtin").is_some() {
            let reason = "`builtin` meshes are not supported; state a `file`, or use another shape";
            return Err(element.refuse_for("builtin", reason));
        }
        element.only(&[&KNOWN])?;
        let refused = |reason: String| element.refuse(reason);
        let mesh = match files.read(element, folder)? {
            Some((path, bytes)) => Mesh::read(&path, &bytes).map_err(refused)?,
            None => Mesh::new(self.points("vertex")?, self.triangles()?).map_err(refused)?,
        };
        let [w, x, y, z] = element.numbers("refquat")?.unwrap_or([1.0, 0.0, 0.0, 0.0]);
        let rotation = normalized([x, y, z, w]).ok_or_else(|| {
            element.refuse_for("refquat", "`refquat` has no direction; correct its numbers")
        })?;
        let position = element.numbers("refpos")?.unwrap_or([0.0; 3]);
        let mesh = mesh.seen_from(&Frame { position, rotation });
        Ok(mesh.scaled(element.numbers("scale")?.unwrap_or([1.0; 3])))
    }

    fn points(&self, name: &str) -> Result<Vec<[f64; 3]>, String> {
        let numbers = self.element.list(name)?;
        let numbers =
            numbers.ok_or_else(|| self.element.refuse("it has neither a file nor vertices"))?;
        let (points, rest) = numbers.as_chunks::<3>();
        if rest.is_empty() {
            Ok(points.to_vec())
        } else {
            Err(self.element.refuse("vertices have three numbers"))
        }
    }

    fn triangles(&self) -> Result<Vec<[usize; 3]>, String> {
        let numbers = self.element.list("face")?.unwrap_or_default();
        let (faces, rest) = numbers.as_chunks::<3>();
        let whole = numbers.iter().all(|number| *number >= 0.0 && number.fract() == 0.0);
        if !rest.is_empty() || !whole {
            let reason = "`face` must have three whole numbers for each triangle, which count vertices from 0";
            return Err(self.element.refuse_for("face", reason));
        }
        Ok(faces.iter().map(|face| face.map(|index| index as usize)).collect())
    }
}
