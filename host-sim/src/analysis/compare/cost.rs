//! What an estimator costs on the Cortex-M4: measured on the virtual board, see docs/estimators.md.

use zwidth::velocity::EstimatorName;

/// Cycles and memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Worst cycles of one update, zero wait states.
    pub cycles: f64,
    /// Bytes of its state and its coefficients.
    pub ram_bytes: f64,
}

/// `estimator,cycles,ram_bytes`; a test holds it against the measurement.
const TABLE: &str = include_str!("../../../data/estimator_cost.csv");

/// The cost of that estimator, if it was measured.
pub fn of(name: EstimatorName) -> Option<Cost> {
    let row = TABLE.lines().find(|line| line.split(',').next() == Some(name.text()))?;
    let mut cells = row.split(',').skip(1).map(str::parse);
    Some(Cost { cycles: cells.next()?.ok()?, ram_bytes: cells.next()?.ok()? })
}
