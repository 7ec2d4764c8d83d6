//! Injects faults into a board while its force is on: named faults, and random flips of single bits. Measures the time
//! until the force is off, and the handle's motion until then. docs/lab/campaigns.md has the tables.
//!
//! | file | holds |
//! |------|-------|
//! | `fault_case`, `no_processor`, `registers`, `outside`, `memory` | named faults, and how each is caused |
//! | `kept` | faults in the data of flash and backup RAM |
//! | `rows` | all named faults, with the time limit of each |
//! | `situation` | free motion, full force and contact, and the force in each situation without a fault |
//! | `place`, `random` | words and registers in which a bit can flip; random flips |
//! | `sample_bits` | each bit of what `sample` keeps, at several cutoffs, estimators and output periods |
//! | `image_flips` | flips in the program in flash |
//! | `tally` | number of flips for each result, and shares |
//! | `verdict` | the result of a fault |
//! | `run` | faults on several threads |
//! | `report` | options and printed results |

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
pub mod sample_bits;
pub mod situation;
pub mod tally;
pub mod verdict;
