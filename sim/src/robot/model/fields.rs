//! Height fields: terrain that is fixed to the world.

use std::collections::BTreeMap;

use super::super::blueprint::HeightField;
use super::super::document::Element;
use super::super::folder::Folder;
use super::super::heights::{self, MOST_HEIGHTS};
use super::blockers::Blockers;
use super::meshes::{Files, insert};

const KNOWN: [&str; 7] = ["name", "file", "content_type", "nrow", "ncol", "size", "elevation"];

/// The height fields of a document, by name.
pub(super) fn read(root: &Element, blockers: &Blockers) -> BTreeMap<String, Element> {
    let mut fields = BTreeMap::new();
    for field in root.all("asset").flat_map(|section| section.all("hfield")) {
        blockers.keep(field.only(&[&KNOWN]));
        blockers.keep(insert(&mut fields, field, field.clone()));
    }
    fields
}

/// The height field that a shape names.
pub(super) fn field(
    geom: &Element,
    (fields, files): (&BTreeMap<String, Element>, &Files),
    folder: &mut Folder<'_>,
) -> Result<HeightField, String> {
    let name = geom.text("hfield").ok_or_else(|| geom.refuse("it names no `hfield`; add one"))?;
    let asset = fields.get(name);
    let known = || fields.keys().map(String::as_str);
    let asset = asset.ok_or_else(|| geom.refuse_name("hfield", "height field", known()))?;
    let (columns, stated) = match files.read(asset, folder)? {
        Some((path, bytes)) => heights::read(&path, asset.text("content_type"), &bytes)
            .map_err(|reason| asset.refuse(reason))?,
        None => stated(asset)?,
    };
    let size = asset.numbers::<4>("size")?;
    let [x, y, top, base] = size.ok_or_else(|| asset.refuse("`size` must have 4 numbers"))?;
    if [x, y, top, base].contains(&0.0) {
        return Err(asset.refuse("`size` must be positive"));
    }
    let low = stated.iter().copied().fold(f64::INFINITY, f64::min);
    let high = stated.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let scale = if high > low { top / (high - low) } else { 0.0 };
    let heights = stated.iter().map(|height| ((height - low) * scale) as f32).collect();
    let [x, y, base] = [x, y, base].map(|length| length as f32);
    Ok(HeightField { half_sizes: [x, y], columns, heights, base })
}

/// Number of columns, and heights that the element states.
fn stated(asset: &Element) -> Result<(usize, Vec<f64>), String> {
    let count = |key: &str| {
        let count = asset.integer(key, 0)?;
        let fits = (2..=MOST_HEIGHTS as i64).contains(&count);
        let why = || asset.refuse(format!("`{key}` must lie in 2..={MOST_HEIGHTS}, is {count}"));
        if fits { Ok(count as usize) } else { Err(why()) }
    };
    let (rows, columns) = (count("nrow")?, count("ncol")?);
    if rows * columns > MOST_HEIGHTS {
        return Err(asset.refuse(format!("it must have at most {MOST_HEIGHTS} heights")));
    }
    let stated = asset.list("elevation")?.unwrap_or_else(|| vec![0.0; rows * columns]);
    // As in MuJoCo, in single precision.
    let stated: Vec<f64> = stated.into_iter().map(|height| f64::from(height as f32)).collect();
    if stated.len() != rows * columns {
        let why = format!("`elevation` must have {} numbers, has {}", rows * columns, stated.len());
        return Err(asset.refuse(why));
    }
    Ok((columns, stated))
}
