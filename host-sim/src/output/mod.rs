//! What a person gets: files that are whole or not there, figures, the report of a sweep, manifests.

pub mod figure;
pub mod files;
pub mod manifest;
pub mod report;
pub mod sweep;
pub mod telemetry;
pub mod trace;
pub mod trade_figures;
