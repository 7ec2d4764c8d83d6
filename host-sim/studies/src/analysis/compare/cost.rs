//! Cost of an estimator on the Cortex-M4, measured on the virtual board. docs/estimators.md has the
//! table.

use zwidth::velocity::EstimatorName;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Worst-case cycles of one update, with zero wait states.
    pub cycles: f64,
    /// Bytes of state and coefficients.
    pub ram_bytes: f64,
}

impl Cost {
    /// Finds the row `name,cycles,ram_bytes` of a table.
    pub fn find(table: &str, name: &str) -> Option<Self> {
        let row = table.lines().find(|line| line.split(',').next() == Some(name))?;
        let mut cells = row.split(',').skip(1).map(str::parse);
        Some(Self { cycles: cells.next()?.ok()?, ram_bytes: cells.next()?.ok()? })
    }
}

/// Cost of an estimator, if measured.
pub fn of(name: EstimatorName) -> Option<Cost> {
    Cost::find(include_str!("../../../../data/estimator_cost.csv"), name.text())
}
