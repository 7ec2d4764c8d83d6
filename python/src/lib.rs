//! The extension module `zwidth._native`: scenes, studies, estimators and results for Python, with their help texts.
//! Type stubs are made from the module when a wheel is built. Units are SI.
#![warn(missing_docs)]
#![expect(clippy::too_many_arguments, reason = "keywords of functions")]

mod compared;
mod estimator;
mod folder;
mod given;
mod measured;
mod recommended;
mod result;
mod scene;
mod studies;
mod study;
mod telemetry;
mod work;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::{
        compared::{
            Comparison, Explanation, Peers, Usable, Winner, compare, explain, peers, usable,
        },
        estimator::Estimator,
        folder::{StudyFolder, StudyUnits, study_text},
        measured::{
            Agreement, CoggingTerm, EncoderTerm, Estimate, Identification, Plan, Replay, Residual,
            Suspect, TermTest, agree, identify, identify_plan, replay,
        },
        recommended::{Recommended, recommended},
        scene::Scene,
        studies::{Grid, Hit, Linear, Sweep, Trace, Walk, grid, hit, linear, sweep, walk},
        study::{Study, study},
        telemetry::{Outputs, Samples, Telemetry},
    };

    /// Three lists of names: the built-in scenes, the estimators, and the codes in `Grid.verdict`.
    #[pyfunction]
    fn names() -> (Vec<&'static str>, Vec<&'static str>, Vec<&'static str>) {
        let scenes = sim_loop::scene::BUILT_IN.iter().map(|(name, _)| *name);
        let estimators = zwidth::velocity::EstimatorName::ALL.iter().map(|name| name.text());
        (scenes.collect(), estimators.collect(), super::studies::VERDICTS.into())
    }

    /// Whether a line of a board's console is the answer to a command.
    #[pyfunction]
    fn is_answer(line: &str) -> bool {
        zwidth::console::is_answer(line)
    }

    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "as Python calls it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
