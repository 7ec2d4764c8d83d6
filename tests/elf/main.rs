//! Flashed programs on the virtual board: the release ELF of each board and of its variants, and programs that measure
//! the cycles of parts of the core. The tests are one program, so that they can run in parallel.
//!
//! By default only the default board's image is built. `cargo test --test elf -- --include-ignored` builds all images
//! and runs all tests.

#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "a test fails loudly; small numbers, addresses of 32 bits"
)]

/// A test on each board. On the default board the test always runs. On the second board the test needs another image,
/// so there it runs in CI only. With a reason to ignore the test, the test runs on both boards in CI only.
macro_rules! each_board {
    ($($test:ident),+) => {$(
        mod $test {
            #[test]
            fn nucleo_f446re() {
                super::$test(virtual_board::board::NUCLEO_F446RE);
            }

            #[test]
            #[ignore = "an image more; CI runs it"]
            fn discovery_f407() {
                super::$test(virtual_board::board::DISCOVERY_F407);
            }
        }
    )+};
    ($test:ident, ignored: $reason:literal) => {
        mod $test {
            #[test]
            #[ignore = $reason]
            fn nucleo_f446re() {
                super::$test(virtual_board::board::NUCLEO_F446RE);
            }

            #[test]
            #[ignore = $reason]
            fn discovery_f407() {
                super::$test(virtual_board::board::DISCOVERY_F407);
            }
        }
    };
}

#[path = "../figure.rs"]
mod figure;

mod alive;
mod boot;
mod campaign;
mod code;
mod control;
mod control_path;
mod designs;
mod edge_times;
mod edges;
mod estimator_cost;
mod estimators;
mod faults;
mod filter_cost;
mod firmware;
mod flood;
mod fuzz;
mod gdb;
mod identify_telemetry;
mod image;
mod instructions;
mod mailbox;
mod panics;
mod passivity;
mod period;
mod probe;
mod profile;
mod quiet;
mod record;
mod replay;
mod rotary;
mod self_test;
mod serve;
mod snapshots;
mod telemetry;
mod twin;
mod walk;
