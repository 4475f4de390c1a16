//! Logs as tables: of every format, whole, damaged and forged; each part in its own file.

mod common;

mod addresses;
mod annotations;
mod conformance;
mod conformance_tables;
mod contradictions;
mod damage;
mod hostile;
mod images;
mod imports;
mod indexes;
mod large;
mod pruning;
mod roles;
mod tables;
mod video;
