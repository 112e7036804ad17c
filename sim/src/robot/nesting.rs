//! How deeply the elements of an XML text are nested. The parser calls itself for each element, so the depth is counted
//! before it.

/// Starts and ends of what is between tags and is no tag.
const SKIPPED: [(&str, &str); 3] = [("!--", "-->"), ("![CDATA[", "]]>"), ("?", "?>")];

/// Byte of the first element that is inside so many others that they are more than `limit` with it. In a text with an error, the
/// depth found is at least the one that the parser reaches before the error.
pub(super) fn first_deeper(text: &str, limit: usize) -> Option<usize> {
    let (mut depth, mut rest) = (0_usize, text);
    while let Some((_, markup)) = rest.split_once('<') {
        let skipped = SKIPPED.iter().find_map(|(start, end)| {
            Some(markup.strip_prefix(start)?.split_once(end).map_or("", |(_, after)| after))
        });
        let tag = &markup[..tag_bytes(markup)];
        rest = skipped.unwrap_or(&markup[tag.len()..]);
        if skipped.is_some() {
            continue;
        }
        if tag.starts_with('/') {
            depth = depth.saturating_sub(1);
        } else if !tag.ends_with('/') {
            depth += 1;
            if depth > limit {
                return Some(text.len() - markup.len() - 1);
            }
        }
    }
    None
}

/// Bytes of a tag up to its `>`, which the value of an attribute may contain too.
fn tag_bytes(tag: &str) -> usize {
    let mut quote = None;
    let end = tag.bytes().position(|byte| {
        match quote {
            None if b"\"'".contains(&byte) => quote = Some(byte),
            Some(open) if open == byte => quote = None,
            _ => {}
        }
        quote.is_none() && byte == b'>'
    });
    end.unwrap_or(tag.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_open_elements_count() {
        let deepest =
            |text: &str| (0..).find(|limit| first_deeper(text, *limit).is_none()).unwrap();
        let depth = |inside: &str| deepest(&format!("<a>{inside}</a>"));
        assert_eq!(first_deeper("<a>\n<b/><b><c>", 2), Some(11));
        assert_eq!(depth("<b/><b></b><b x='/'/>"), 2);
        assert_eq!(depth("<b x=\"/>\"><b x='\"/>'><b x='/>' ></b></b></b>"), 4);
        for hidden in
            ["<!--</a>-->", "<!--<b>-->", "<![CDATA[</a><b>]]>", "<?p </a><b>?>", "<!--'-->"]
        {
            assert_eq!(depth(&format!("<b>{hidden}<c/></b>")), 2, "{hidden}");
            assert_eq!(depth(&format!("<b>{hidden}<c></c></b>")), 3, "{hidden}");
        }
        for cut in ["<", "<a", "<a x='", "<!--", "<![CDATA[", "<?", "</", "text", ""] {
            assert!(deepest(cut) <= 1, "{cut}");
        }
    }
}
