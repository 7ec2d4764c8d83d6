//! `cargo board`.

use std::process::ExitCode;

fn main() -> ExitCode {
    virtual_board::cli::main()
}
