//! Runs the core and the simulator together on the host, and compares them with theory, paper and documentation.

#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "a test fails loudly; small numbers"
)]

#[path = "../figure.rs"]
mod figure;

mod closed_loop;
mod commit;
mod criteria;
mod defaults;
mod design;
mod elements;
mod entrances;
mod estimator_bench;
mod estimators_linear;
mod estimators_observers;
mod estimators_position;
mod estimators_time_stamps;
mod explain;
mod extremes;
mod filter;
mod force_step;
mod identify_accuracy;
mod identify_devices;
mod identify_joint;
mod identify_terms;
mod linear_elements;
mod paper;
mod passivity;
mod peers;
mod plant;
mod small_signal;
mod soak;
