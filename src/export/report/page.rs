//! The page around the content: shell, head, warnings, key figures.

use crate::scene::{Calibration, CalibrationMethod};

use super::html::escape;

/// A whole page around a body of HTML.
pub(super) fn page(title: &str, body_html: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{}</title>\n<style>\n{}</style>\n</head>\n\
         <body>\n<main>\n{body_html}</main>\n<footer>pitchd {}</footer>\n</body>\n</html>\n",
        escape(title),
        include_str!("style.css"),
        env!("CARGO_PKG_VERSION")
    )
}

/// What is always worth saying at the head: name and value.
pub(super) fn facts(title: &str, calibration: &Calibration) -> Vec<(String, String)> {
    let method = match calibration.method {
        CalibrationMethod::Joint => "joint estimate",
        CalibrationMethod::Kim2019 => "kim2019",
    };
    let version = format!("{method}, calibration version {}", calibration.version);
    vec![
        ("Session".to_owned(), title.to_owned()),
        ("Method".to_owned(), version),
        ("Reference camera".to_owned(), calibration.reference.to_string()),
    ]
}

/// Site, headline and facts, all plain text.
pub(super) fn head(site: &str, headline: &str, facts: &[(String, String)]) -> String {
    let facts: String = facts
        .iter()
        .map(|(name, value)| format!("<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value)))
        .collect();
    format!(
        "<header>\n<p class=\"kicker\">{}</p>\n<h1>{}</h1>\n<dl class=\"facts\">{facts}</dl>\n</header>\n",
        escape(site),
        escape(headline)
    )
}

/// The box of warnings (HTML each); nothing without any.
pub(super) fn warnings(items_html: &[String]) -> String {
    if items_html.is_empty() {
        return String::new();
    }
    let items: String = items_html.iter().map(|w| format!("<li>{w}</li>")).collect();
    format!(
        "<section class=\"warnings\" aria-label=\"Warnings\"><h2>Mind this</h2><ul>{items}</ul></section>\n"
    )
}

/// The row of key figures: value (HTML) and what it is.
pub(super) fn tiles(tiles: &[(String, &str)]) -> String {
    let tiles: String = tiles
        .iter()
        .map(|(value, name)| format!("<div><b>{value}</b><span>{name}</span></div>"))
        .collect();
    format!("<section class=\"figures\" aria-label=\"Key figures\">{tiles}</section>\n")
}
