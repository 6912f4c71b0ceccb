//! "Did you mean": the nearest known word, and one-line explanations of parser messages.

/// The known word nearest to `word`, where one is near enough to be meant.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known
        .into_iter()
        .map(|k| (k, strsim::jaro_winkler(word, k)))
        .filter(|(_, likeness)| *likeness > 0.75)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(k, _)| k)
}

/// Adds the nearest known word to serde's "unknown field/variant `x`, expected one of `a`, `b`", on one line.
pub(super) fn explain(message: &str) -> String {
    let message = message.trim().replace('\n', "; ");
    let mut quoted = message.split('`').skip(1).step_by(2);
    if !message.starts_with("unknown ") {
        return message;
    }
    let Some(word) = quoted.next() else {
        return message;
    };
    let kind = if message.starts_with("unknown variant") {
        "value"
    } else {
        "key"
    };
    let known: Vec<&str> = quoted.collect();
    match nearest(word, known.iter().copied()) {
        Some(near) => format!("unknown {kind} `{word}`: did you mean `{near}`?"),
        None => format!("unknown {kind} `{word}`; known: {}", known.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_typo_is_answered_with_the_key_that_was_meant() {
        let told = explain("unknown field `fx_pix`, expected one of `fx_px`, `fy_px`, `cx_px`");
        assert_eq!(told, "unknown key `fx_pix`: did you mean `fx_px`?");
    }

    #[test]
    fn a_word_like_nothing_lists_what_is_known() {
        let told = explain("unknown variant `zzz`, expected `flight` or `free`");
        assert_eq!(told, "unknown value `zzz`; known: flight, free");
    }
}
