//! What a person or another program sees of the results: files, tables and the report.

pub mod report;
pub mod results;
pub mod statcast;
pub mod table;
pub mod trackman;

mod date;
mod error;
#[cfg(test)]
mod fixture;
mod quoted_csv;

pub use error::ExportError;
