//! Files with the heights of a field: PNG images and MuJoCo's own format.

use std::io::Cursor;

use png::{Decoder, Limits, Transformations};

/// Most heights of a field.
pub(super) const MOST_HEIGHTS: usize = 1 << 20;
/// Memory of the image decoder, bytes.
const DECODER_BYTES: usize = 16 << 20;

/// Number of columns, and the heights by rows, the one with the largest y first, in any unit. A content type counts more than
/// the file's name.
pub(super) fn read(
    path: &str,
    content_type: Option<&str>,
    bytes: &[u8],
) -> Result<(usize, Vec<f64>), String> {
    let is_named = path.to_ascii_lowercase().ends_with(".png");
    let is_image = content_type.map_or(is_named, |stated| stated == "image/png");
    let read = if is_image { read_image(bytes) } else { read_numbers(bytes) };
    read.map_err(|reason| format!("{path}: {reason}"))
}

/// Checks the size that a file states before any memory is taken for it.
fn checked(rows: usize, columns: usize) -> Result<usize, String> {
    match rows.checked_mul(columns) {
        Some(count) if rows >= 2 && columns >= 2 && count <= MOST_HEIGHTS => Ok(count),
        _ => Err(format!(
            "it has {rows} x {columns} heights; at least 2 x 2 and at most {MOST_HEIGHTS} are allowed"
        )),
    }
}

/// The first channel of an image, as in MuJoCo.
fn read_image(bytes: &[u8]) -> Result<(usize, Vec<f64>), String> {
    let invalid = |error| format!("it is not a valid PNG image: {error}");
    let limits = Limits { bytes: DECODER_BYTES };
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::normalize_to_color8());
    let info = decoder.read_header_info().map_err(invalid)?;
    let (rows, columns) = (info.height as usize, info.width as usize);
    checked(rows, columns)?;
    let mut reader = decoder.read_info().map_err(invalid)?;
    let size = reader.output_buffer_size().ok_or("the image is too large")?;
    let mut pixels = vec![0; size];
    let frame = reader.next_frame(&mut pixels).map_err(invalid)?;
    let lines = pixels.chunks_exact(frame.line_size).take(rows);
    let heights = lines.flat_map(|line| {
        line.iter().step_by(frame.color_type.samples()).take(columns).map(|level| f64::from(*level))
    });
    Ok((columns, heights.collect()))
}

/// Numbers of rows and columns, then all heights, the row with the least y first.
fn read_numbers(bytes: &[u8]) -> Result<(usize, Vec<f64>), String> {
    let words: Vec<[u8; 4]> = bytes.as_chunks::<4>().0.to_vec();
    let [rows, columns, heights @ ..] = &*words else {
        return Err("it has no numbers of rows and columns".to_owned());
    };
    let [rows, columns] = [rows, columns].map(|word| u32::from_le_bytes(*word) as usize);
    let count = checked(rows, columns)?;
    if bytes.len() != 8 + 4 * count {
        return Err(format!(
            "{rows} x {columns} heights need {} bytes, it has {}",
            8 + 4 * count,
            bytes.len()
        ));
    }
    let heights: Vec<f64> =
        heights.iter().map(|word| f64::from(f32::from_le_bytes(*word))).collect();
    if heights.iter().any(|height| !height.is_finite()) {
        return Err("a height is not finite".to_owned());
    }
    Ok((columns, heights.chunks_exact(columns).rev().flatten().copied().collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey image of 16 bits with these levels.
    fn image(columns: u32, levels: &[u16]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, columns, levels.len() as u32 / columns);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let data: Vec<u8> = levels.iter().flat_map(|level| level.to_be_bytes()).collect();
        encoder.write_header().unwrap().write_image_data(&data).unwrap();
        bytes
    }

    fn numbers(rows: u32, columns: u32, heights: &[f32]) -> Vec<u8> {
        let sizes = [rows, columns].map(u32::to_le_bytes);
        sizes
            .into_iter()
            .chain(heights.iter().map(|height| height.to_le_bytes()))
            .flatten()
            .collect()
    }

    #[test]
    fn an_image_and_a_file_of_numbers_give_rows_from_the_largest_y() {
        let levels = [0x0100, 0x02ff, 0x0300, 0x0400, 0x0500, 0xff00];
        let heights = vec![1.0, 2.0, 3.0, 4.0, 5.0, 255.0];
        assert_eq!(read("a.PNG", None, &image(3, &levels)).unwrap(), (3, heights.clone()));
        let file = numbers(2, 3, &[4.0, 5.0, 255.0, 1.0, 2.0, 3.0]);
        assert_eq!(read("a.bin", None, &file).unwrap(), (3, heights.clone()));
        let stated = read("a.dat", Some("image/png"), &image(3, &levels));
        assert_eq!(stated.unwrap(), (3, heights), "the content type counts");
    }

    #[test]
    fn stated_sizes_are_refused_before_memory_is_taken() {
        let mut giant = image(2, &[0, 1, 2, 3]);
        // Width and height in the header, whose checksum follows.
        giant[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
        let crc = crc(&giant[12..29]).to_be_bytes();
        giant[29..33].copy_from_slice(&crc);
        let refusal = |path: &str, bytes: &[u8]| read(path, None, bytes).unwrap_err();
        assert!(refusal("a.png", &giant).contains("at most 1048576 are allowed"));
        assert!(refusal("a.png", b"no image").contains("not a valid PNG image"));
        let cut = image(2, &[0, 1, 2, 3]);
        assert!(refusal("a.png", &cut[..cut.len() - 20]).contains("not a valid PNG image"));
        assert!(refusal("a.bin", &numbers(u32::MAX, u32::MAX, &[])).contains("are allowed"));
        assert!(refusal("a.bin", &numbers(1, 9, &[0.0; 9])).contains("at least 2 x 2"));
        assert!(refusal("a.bin", &numbers(2, 2, &[0.0; 3])).contains("need 24 bytes, it has 20"));
        assert!(refusal("a.bin", &numbers(2, 2, &[0.0, 1.0, 2.0, f32::NAN])).contains("finite"));
        assert!(refusal("a.bin", &[1, 2]).contains("no numbers of rows"));
    }

    fn crc(bytes: &[u8]) -> u32 {
        let fold = |crc: u32, byte: &u8| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 * (crc & 1)))
        };
        !bytes.iter().fold(!0, fold)
    }
}
