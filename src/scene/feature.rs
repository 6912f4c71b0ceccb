//! A camera's feature by its GenICam name, as the rig's owner sets it.

/// A feature's value.
#[derive(Debug, Clone, PartialEq)]
pub enum FeatureValue {
    /// Of a boolean feature; `true` executes a command.
    Switch(bool),
    /// Of an integer feature.
    Integer(i64),
    /// Of a floating-point feature.
    Float(f64),
    /// Of a text or an enumeration.
    Text(String),
}

impl std::fmt::Display for FeatureValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Switch(value) => write!(f, "{value}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Float(value) => write!(f, "{value:?}"),
            Self::Text(value) => write!(f, "{value:?}"),
        }
    }
}
