//! The extension module `zwidth._native`: scenes, studies and estimators of the simulator and the control core for
//! Python. `zwidth/__init__.py` makes results of what these functions return; units are SI.

mod columns;
mod compared;
mod estimator;
mod folder;
mod measured;
mod scene;
mod studies;
mod study;
mod telemetry;
mod work;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::{
        compared::{compare, explain, peers, usable},
        estimator::{Estimator, velocity_table, with_estimator},
        folder::{StudyFolder, StudyUnits, study_text},
        measured::{agree, identify, identify_plan, replay},
        scene::Scene,
        studies::{grid, hit, linear, sweep, walk},
        study::study,
        telemetry::decode,
    };

    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("ESTIMATORS", super::estimator::names())?;
        module.add(
            "SCENES",
            sim_loop::scene::BUILT_IN.iter().map(|(name, _)| *name).collect::<Vec<_>>(),
        )
    }
}
