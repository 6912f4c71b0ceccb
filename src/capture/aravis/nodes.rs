//! Is a camera's description a graph of nodes that the library can walk? It follows every reference it finds, so that a
//! value which depends on itself ends in a stack that is full, and one that doubles at every step in a wait without end.

use std::collections::BTreeMap;

use roxmltree::{Document, Node, ParsingOptions};

/// Elements and texts of a description; the largest known ones have 150 000.
const NODES_MOST: u32 = 2_000_000;
const DEPTH_MOST: usize = 64;
/// Attributes are compared with each other.
const TAG_BYTES_MOST: usize = 16 << 10;
/// Reads that one value may take; the largest known ones take some dozens.
const READS_MOST: u64 = 5000;
/// A register as long as this is a file, not a feature.
const LENGTH_MOST: i64 = 16 << 20;

/// Elements by which a node's value depends on another's value.
const VALUE_OF: [&str; 8] = [
    "pValue",
    "pAddress",
    "pVariable",
    "pIndex",
    "pLength",
    "pValueIndexed",
    "pValueDefault",
    "pValueCopy",
];

/// Refuses what the library could not walk.
///
/// # Errors
/// What is wrong, in words.
pub fn check(xml: &[u8]) -> Result<(), String> {
    let text = String::from_utf8_lossy(xml);
    let text = text
        .trim_start_matches('\u{feff}')
        .trim_end_matches(['\0', ' ', '\r', '\n', '\t']);
    let options = ParsingOptions {
        // Entities multiply.
        allow_dtd: false,
        nodes_limit: NODES_MOST,
        ..ParsingOptions::default()
    };
    if depth(text)? > DEPTH_MOST {
        return Err(format!("its elements are nested more than {DEPTH_MOST} deep"));
    }
    let document = Document::parse_with_options(text, options).map_err(|e| format!("it is no XML: {e}"))?;
    let root = document.root_element();
    if root.tag_name().name() != "RegisterDescription" {
        return Err(format!(
            "it is a {:?}, not a RegisterDescription",
            shown(root.tag_name().name())
        ));
    }
    lengths(root)?;
    Graph::of(root).walk()
}

/// A name of the camera's in a message: one line, not long.
fn shown(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(60).collect()
}

/// Deepest nesting by a count of tags, in one pass, before anything walks the tree.
fn depth(text: &str) -> Result<usize, String> {
    let (mut depth, mut most) = (0_usize, 0);
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        rest = rest.get(at..).unwrap_or_default();
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")]
            .iter()
            .find(|(begin, _)| rest.starts_with(begin))
            .map(|(_, end)| rest.split_once(end).map_or("", |(_, behind)| behind));
        if let Some(behind) = skipped {
            rest = behind;
            continue;
        }
        let tag = tag_bytes(rest).ok_or("it is no XML: a tag has no end, or is absurdly long")?;
        let (inside, behind) = rest.split_at_checked(tag).unwrap_or((rest, ""));
        if inside.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !inside.starts_with("<!") {
            most = most.max(depth + 1);
            depth += usize::from(!inside.ends_with("/>"));
        }
        rest = behind;
    }
    Ok(most)
}

/// Bytes of the tag that a text begins with; an attribute may hold `>`.
fn tag_bytes(text: &str) -> Option<usize> {
    let mut quote = None;
    for (at, byte) in text.bytes().enumerate().take(TAG_BYTES_MOST) {
        match (quote, byte) {
            (None, b'>') => return Some(at + 1),
            (None, b'"' | b'\'') => quote = Some(byte),
            (Some(open), byte) if open == byte => quote = None,
            _ => {}
        }
    }
    None
}

/// The library allocates what a register states as its length.
fn lengths(root: Node<'_, '_>) -> Result<(), String> {
    for node in root.descendants().filter(|n| n.tag_name().name() == "Length") {
        let text = node.text().unwrap_or_default().trim();
        let length = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
            Some(hex) => i64::from_str_radix(hex, 16),
            None => text.parse(),
        };
        if !length.is_ok_and(|n| (1..=LENGTH_MOST).contains(&n)) {
            return Err(format!("a register has the length {:?}", shown(text)));
        }
    }
    Ok(())
}

/// Which values each node's value is made of, by number.
struct Graph<'a> {
    names: Vec<&'a str>,
    uses: Vec<Vec<usize>>,
}

#[derive(Clone, Copy)]
enum Seen {
    No,
    Open,
    Reads(u64),
}

impl<'a> Graph<'a> {
    fn of(root: Node<'a, '_>) -> Self {
        let named: Vec<_> = root
            .descendants()
            .filter(|n| n.is_element() && n.tag_name().name() != "EnumEntry")
            .filter_map(|n| Some((n.attribute("Name")?, n)))
            .filter(|(_, n)| !VALUE_OF.contains(&n.tag_name().name()))
            .collect();
        let numbers: BTreeMap<&str, usize> = named
            .iter()
            .enumerate()
            .map(|(k, (name, _))| (*name, k))
            .collect();
        let uses = named.iter().map(|(_, node)| {
            let parts = node
                .descendants()
                .filter(|n| VALUE_OF.contains(&n.tag_name().name()));
            parts
                .filter_map(|n| numbers.get(n.text()?.trim()).copied())
                .collect()
        });
        Self {
            uses: uses.collect(),
            names: named.iter().map(|(name, _)| *name).collect(),
        }
    }

    /// Depth first, with a stack of its own.
    fn walk(&self) -> Result<(), String> {
        let mut seen = vec![Seen::No; self.names.len()];
        for start in 0..self.names.len() {
            let mut stack = vec![start];
            while let Some(&at) = stack.last() {
                let uses = self.uses.get(at).map_or(&[][..], Vec::as_slice);
                let state = |k: &usize| seen.get(*k).copied().unwrap_or(Seen::Reads(0));
                match state(&at) {
                    Seen::Reads(_) => {
                        stack.pop();
                    }
                    Seen::No => {
                        if let Some(own) = seen.get_mut(at) {
                            *own = Seen::Open;
                        }
                        for k in uses {
                            match seen.get(*k) {
                                Some(Seen::Open) => return Err(self.circle(*k)),
                                Some(Seen::No) => stack.push(*k),
                                _ => {}
                            }
                        }
                    }
                    Seen::Open => {
                        let mut reads = uses.iter().map(|k| match state(k) {
                            Seen::Reads(n) => Ok(n),
                            Seen::Open | Seen::No => Err(self.circle(*k)),
                        });
                        let reads =
                            reads.try_fold(1_u64, |sum, n| Ok::<_, String>(sum.saturating_add(n?)))?;
                        if reads > READS_MOST {
                            return Err(format!("the value of {:?} takes {reads} reads", self.name(at)));
                        }
                        if let Some(own) = seen.get_mut(at) {
                            *own = Seen::Reads(reads);
                        }
                        stack.pop();
                    }
                }
            }
        }
        Ok(())
    }

    fn name(&self, k: usize) -> String {
        self.names.get(k).map(|name| shown(name)).unwrap_or_default()
    }

    fn circle(&self, k: usize) -> String {
        format!("the value of {:?} depends on itself", self.name(k))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn description(nodes: &str) -> String {
        format!(
            "\u{feff}<?xml version=\"1.0\"?><RegisterDescription ModelName=\"m\">{nodes}</RegisterDescription>\0\0"
        )
    }

    #[test]
    fn registers_formulas_and_selectors_are_a_graph() {
        let good = description(
            "<Integer Name=\"Width\"><pValue>WidthReg</pValue><pMax>WidthMost</pMax><pSelected>Width</pSelected></Integer>\
             <IntReg Name=\"WidthReg\"><IntSwissKnife Name=\"WidthAt\"><pVariable Name=\"A\">Base</pVariable></IntSwissKnife>\
             <Length>4</Length></IntReg><Integer Name=\"Base\"><Value>7</Value></Integer>\
             <IntSwissKnife Name=\"WidthMost\"><pVariable Name=\"X\">OffsetX</pVariable></IntSwissKnife>\
             <Integer Name=\"OffsetX\"><Value>0</Value><pMax>OffsetMost</pMax></Integer>\
             <IntSwissKnife Name=\"OffsetMost\"><pVariable Name=\"W\">Width</pVariable></IntSwissKnife>\
             <!-- <a><a> --><Group Comment=\"a > b\"><Node Name='x>y'/></Group><![CDATA[<a>]]>",
        );
        assert_eq!(
            check(good.as_bytes()),
            Ok(()),
            "limits may depend on each other's values"
        );
    }

    #[test]
    fn what_the_library_cannot_walk_is_refused_by_name() {
        let node = |k: usize, uses: &[usize]| {
            let uses: String = uses
                .iter()
                .map(|u| format!("<pVariable Name=\"V\">N{u}</pVariable>"))
                .collect();
            format!("<SwissKnife Name=\"N{k}\">{uses}</SwissKnife>")
        };
        let chain: String = (0..50).map(|k| node(k, &[k + 1, k + 1])).collect();
        for (nodes, why) in [
            (node(0, &[0]), "\"N0\" depends on itself"),
            (
                node(0, &[1]) + &node(1, &[2]) + &node(2, &[1]),
                "depends on itself",
            ),
            (chain, "takes"),
            ("<a>".repeat(5000) + &"</a>".repeat(5000), "nested"),
            (
                "<IntReg Name=\"R\"><Length>0x7fffffffffff</Length></IntReg>".into(),
                "length",
            ),
            ("<IntReg Name=\"R\"><Length>-4</Length></IntReg>".into(), "length"),
            ("<a>".into(), "no XML"),
            ("<".repeat(3_000_000), "no XML"),
            (
                format!(
                    "<a {}/>",
                    (0..9000).map(|k| format!("a{k}=\"\" ")).collect::<String>()
                ),
                "absurdly long",
            ),
        ] {
            let error = check(description(&nodes).as_bytes()).unwrap_err();
            assert!(error.contains(why), "{error}");
        }
        let bomb = "<!DOCTYPE a [<!ENTITY x \"xxxx\"><!ENTITY y \"&x;&x;\">]><RegisterDescription/>";
        assert!(check(bomb.as_bytes()).unwrap_err().contains("no XML"));
        assert!(
            check(b"<html/>")
                .unwrap_err()
                .contains("not a RegisterDescription")
        );
        assert!(check(b"").is_err() && check(&[0xff; 100]).is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn no_text_makes_it_panic(text in "(<(/?|!|\\?)[A-Za-z]{0,9}( Name=\"N[0-3]\")?/?>|N[0-3]|<pValue>N[0-3]</pValue>|&[a-z]{1,3};|[ -~]){0,60}") {
            let _ = check(text.as_bytes());
            let _ = check(description(&text).as_bytes());
        }
    }
}
