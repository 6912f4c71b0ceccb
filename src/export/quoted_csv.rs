//! CSV as the public pitch files have it: every value in quotes, nothing at all where a value is unknown.

/// One line, ended: values quoted, quotes inside doubled, unknown values blank.
pub(super) fn line<'a>(values: impl IntoIterator<Item = Option<&'a str>>) -> String {
    let mut text = String::new();
    for (i, value) in values.into_iter().enumerate() {
        if i > 0 {
            text.push(',');
        }
        if let Some(value) = value {
            text.push('"');
            text += &value.replace('"', "\"\"");
            text.push('"');
        }
    }
    text.push('\n');
    text
}

/// A number with at most `decimals` places and no trailing zeros; `None` where it is not finite.
pub(super) fn number(value: f64, decimals: usize) -> Option<String> {
    if !value.is_finite() {
        return None;
    }
    let mut text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.truncate(text.trim_end_matches('0').trim_end_matches('.').len());
    }
    Some(if text == "-0" { "0".to_owned() } else { text })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_quoted_and_unknown_ones_blank() {
        assert_eq!(line([Some("a\"b"), None, Some("1,2")]), "\"a\"\"b\",,\"1,2\"\n");
    }

    #[test]
    fn numbers_are_short_and_never_a_negative_zero() {
        assert_eq!(number(88.630_000_1, 4).unwrap(), "88.63");
        assert_eq!(number(-0.000_01, 3).unwrap(), "0");
        assert_eq!(number(100.0, 0).unwrap(), "100");
        assert_eq!(number(f64::NAN, 2), None);
    }
}
