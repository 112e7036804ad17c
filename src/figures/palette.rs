//! Colours that people with any kind of colour vision can tell apart.

/// Red, green, blue.
pub(crate) type Rgb = [u8; 3];

/// Okabe and Ito's colours; the last is too pale for a thin line on white.
pub(crate) const OKABE_ITO: [Rgb; 8] = [
    [0x00, 0x72, 0xB2],
    [0xD5, 0x5E, 0x00],
    [0x00, 0x9E, 0x73],
    [0xCC, 0x79, 0xA7],
    [0xE6, 0x9F, 0x00],
    [0x56, 0xB4, 0xE9],
    [0x00, 0x00, 0x00],
    [0xF0, 0xE4, 0x42],
];

/// `#0072b2`
pub(crate) fn hex([red, green, blue]: Rgb) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_is_written_as_style_sheets_do() {
        assert_eq!(hex(OKABE_ITO[0]), "#0072b2");
    }
}
