//! Cost of an estimator on the Cortex-M4, in cycles and bytes. It is measured on the virtual board. docs/estimators.md
//! has the table.

use zwidth::velocity::EstimatorName;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Largest number of cycles of one update. The memory has zero wait states.
    pub cycles: f64,
    /// Size of the estimator's state and coefficients.
    pub ram_bytes: f64,
}

impl Cost {
    /// Finds the row of an estimator in a table with the columns `name,cycles,ram_bytes`.
    pub fn find(table: &str, name: &str) -> Option<Self> {
        let row = table.lines().find(|line| line.split(',').next() == Some(name))?;
        let mut cells = row.split(',').skip(1).map(str::parse);
        Some(Self { cycles: cells.next()?.ok()?, ram_bytes: cells.next()?.ok()? })
    }
}

/// Cost of an estimator; `None` if it was not measured.
pub fn of(name: EstimatorName) -> Option<Cost> {
    Cost::find(include_str!("../../../../data/estimator_cost.csv"), name.text())
}
