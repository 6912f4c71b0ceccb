//! Words, numbers and tables as HTML. Every text that comes from outside goes through [`escape`].

/// Text that cannot end an element or an attribute.
pub(super) fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe += "&amp;",
            '<' => safe += "&lt;",
            '>' => safe += "&gt;",
            '"' => safe += "&quot;",
            '\'' => safe += "&#39;",
            _ => safe.push(c),
        }
    }
    safe
}

/// A number with a real minus sign and no negative zero; a dash where it is not finite.
pub(super) fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().any(|b| (b'1'..=b'9').contains(&b)) => format!("−{rest}"),
        Some(rest) => rest.to_owned(),
        None => text,
    }
}

/// `1 pitch`, `2 pitches`: the count and its noun.
pub(super) fn count(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

/// The middle value of the finite ones; `None` without any.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// A column: its heading and the unit below it (both HTML), and what it means on hover (plain text).
pub(super) struct Column {
    pub heading_html: &'static str,
    pub unit_html: &'static str,
    pub meaning: &'static str,
    pub content: Content,
}

/// What a column holds, which decides how it is set.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Content {
    /// To the right, decimals below each other.
    Numbers,
    /// To the left.
    Words,
}

impl Column {
    /// A column of numbers.
    pub(super) const fn numbers(
        heading_html: &'static str,
        unit_html: &'static str,
        meaning: &'static str,
    ) -> Self {
        Self {
            heading_html,
            unit_html,
            meaning,
            content: Content::Numbers,
        }
    }

    /// A column of words.
    pub(super) const fn words(
        heading_html: &'static str,
        unit_html: &'static str,
        meaning: &'static str,
    ) -> Self {
        Self {
            heading_html,
            unit_html,
            meaning,
            content: Content::Words,
        }
    }

    fn class(&self) -> &'static str {
        match self.content {
            Content::Numbers => "",
            Content::Words => " class=\"words\"",
        }
    }
}

/// A table in a box that scrolls sideways on a narrow screen; the first cell of each row is its heading.
/// Cells are HTML.
pub(super) fn table(label: &str, columns: &[Column], rows: &[Vec<String>]) -> String {
    let head: String = columns
        .iter()
        .map(|c| {
            format!(
                "<th scope=\"col\"{} title=\"{}\">{}<small>{}</small></th>",
                c.class(),
                escape(c.meaning),
                c.heading_html,
                c.unit_html
            )
        })
        .collect();
    let body: String = rows
        .iter()
        .map(|row| {
            let cells: String = row
                .iter()
                .zip(columns)
                .enumerate()
                .map(|(i, (cell, column))| match i {
                    0 => format!("<th scope=\"row\">{cell}</th>"),
                    _ => format!("<td{}>{cell}</td>", column.class()),
                })
                .collect();
            format!("<tr>{cells}</tr>\n")
        })
        .collect();
    format!(
        "<div class=\"scroll\" role=\"region\" tabindex=\"0\" aria-label=\"{}\"><table>\n\
         <thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody>\n</table></div>\n",
        escape(label)
    )
}

/// A picture with what it shows below it; `caption_html` is HTML.
pub(super) fn figure(class: &str, picture: &str, caption_html: &str) -> String {
    format!(
        "<figure class=\"{class}\"><div class=\"canvas\">{picture}</div><figcaption>{caption_html}</figcaption></figure>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(
            escape("<a href='x'>\"&\"</a>"),
            "&lt;a href=&#39;x&#39;&gt;&quot;&amp;&quot;&lt;/a&gt;"
        );
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!(number(-1.25, 1), "−1.2");
        assert_eq!(number(-0.01, 1), "0.0");
        assert_eq!(number(f64::INFINITY, 1), "–");
    }

    #[test]
    fn the_median_leaves_out_what_is_not_finite() {
        assert_eq!(median([3.0, f64::NAN, 1.0, 2.0].into_iter()), Some(2.0));
        assert_eq!(median(std::iter::empty()), None);
    }
}
