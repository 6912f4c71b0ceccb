//! One file a subcommand; no mathematics.
