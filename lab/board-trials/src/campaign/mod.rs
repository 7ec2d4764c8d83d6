//! Faults done to a board while its force is on: named ones, and single bits at random. How long until it is off, and
//! what the handle gets meanwhile. docs/lab/campaigns.md has the tables.
//!
//! | file | holds |
//! |------|-------|
//! | `fault_case`, `no_processor`, `registers`, `outside`, `memory` | named faults, and how each is brought about |
//! | `kept` | the same of what is kept in flash and backup RAM |
//! | `rows` | all of them, with the time that each may take |
//! | `situation` | free, with the whole force and in contact, and what the force is there without a fault |
//! | `place`, `random` | where a bit can flip, and flips |
//! | `image_flips` | flips in the program in flash |
//! | `verdict` | what came of a fault |
//! | `run` | faults on several threads |
//! | `report` | options, and what is printed |

pub mod fault_case;
pub mod image_flips;
pub mod kept;
mod memory;
mod no_processor;
pub mod outside;
pub mod place;
pub mod random;
pub mod registers;
pub mod report;
pub mod row;
pub mod rows;
pub mod run;
pub mod situation;
pub mod verdict;
