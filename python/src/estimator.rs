//! The core's velocity estimators over recorded counts.

use numpy::{IntoPyArray as _, PyArray1, PyReadonlyArray1};
use pyo3::{exceptions::PyValueError, prelude::*};
use sim_loop::{
    error::Error,
    scene::{NamedScene, VelocityTable},
    simulation::controller::lsb_per_m_per_s,
};
use sim_studies::study::asked::{self, Names};
use zwidth::{
    CounterWidth, Design, LoopParameters, Sampler,
    units::{Acceleration, Force},
    velocity::{Edge, EstimatorName, Sense, Senses},
};

use crate::{
    scene::{Scene, of_python, to_python},
    work::raised,
};

/// One estimator with its state.
#[pyclass(module = "zwidth._native")]
pub struct Estimator {
    parameters: LoopParameters,
    design: Design,
    sense: Option<Sense>,
    /// `None` before the first count.
    sampler: Option<Sampler>,
}

/// Counts between two looks at the interpreter's signals: some milliseconds.
const BLOCK: usize = 1 << 16;
const NAMES: Names =
    Names { cutoff: "cutoff", stiffness: "", damping: "", start_offset: "start_offset" };

/// Names of all estimators.
pub fn names() -> Vec<&'static str> {
    EstimatorName::ALL.iter().map(|name| name.text()).collect()
}

/// The scene's table `[velocity]` for the estimator of that name, every parameter at its default.
#[pyfunction]
pub fn velocity_table<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    let found = EstimatorName::ALL.iter().find(|known| known.text() == name);
    let found = found.ok_or_else(|| {
        PyValueError::new_err(match EstimatorName::replacing(name) {
            Some(other) => format!("estimator {name:?} is no more: use {other}"),
            None => format!("there is no estimator {name:?}, allowed {}", names().join(", ")),
        })
    })?;
    let filter = VelocityTable::from(found.defaults()).with_cutoff(None);
    let table = toml::Table::try_from(filter)
        .map_err(|error| raised(Error::Internal(error.to_string())))?;
    to_python(py, &toml::Value::Table(table))
}

/// That scene with another table `[velocity]`, swept over that cutoff alone.
#[pyfunction]
pub fn with_estimator(
    scene: &Scene,
    velocity: &Bound<'_, PyAny>,
    cutoff: Option<f64>,
) -> PyResult<Scene> {
    let mut other = NamedScene::clone(&scene.0);
    let internal = |error: toml::ser::Error| raised(Error::Internal(error.to_string()));
    other.scene.velocity = of_python(velocity)?
        .try_into()
        .map_err(|error: toml::de::Error| PyValueError::new_err(error.message().to_owned()))?;
    let hit = asked::hit(&other, cutoff, None, 0.0, NAMES).map_err(raised)?;
    if let Some(cutoff_hz) = hit.velocity.cutoff_hz() {
        other.scene.sweep.cutoffs_hz = vec![cutoff_hz];
    }
    let text = toml::to_string(&other.scene).map_err(internal)?;
    NamedScene::parse(other.name.clone(), text, &other.name).map(Scene::from).map_err(raised)
}

#[pymethods]
impl Estimator {
    #[new]
    #[pyo3(signature = (scene, cutoff = None))]
    fn new(scene: &Scene, cutoff: Option<f64>) -> PyResult<Self> {
        let scene = &scene.0;
        let hit = asked::hit(scene, cutoff, None, 0.0, NAMES).map_err(raised)?;
        let design = scene.scene.design();
        let parameters = scene
            .scene
            .settings(hit.velocity, hit.stiffness_n_per_m, hit.damping_n_s_per_m)
            .build(&design)
            .map_err(|error| raised(Error::input(error)))?;
        Ok(Self { parameters, design, sense: scene.scene.velocity.sense(), sampler: None })
    }

    /// What it needs beside the counts: "force", "acceleration", "edge times" or None.
    #[getter]
    fn needs(&self) -> Option<&'static str> {
        self.sense.map(Sense::text)
    }

    /// Velocity of an LSB, m/s.
    #[getter]
    fn lsb_m_per_s(&self) -> f64 {
        1.0 / lsb_per_m_per_s(&self.design)
    }

    /// Forgets every count.
    fn reset(&mut self) {
        self.sampler = None;
    }

    /// Velocities at these counts, LSB, int32; goes on where the last block ended.
    #[pyo3(signature = (counts, force = None, acceleration = None, edge_age = None, edge_up = None))]
    fn process<'py>(
        &mut self,
        py: Python<'py>,
        counts: PyReadonlyArray1<'py, i64>,
        force: Option<PyReadonlyArray1<'py, i32>>,
        acceleration: Option<PyReadonlyArray1<'py, i32>>,
        edge_age: Option<PyReadonlyArray1<'py, i64>>,
        edge_up: Option<PyReadonlyArray1<'py, bool>>,
    ) -> PyResult<Bound<'py, PyArray1<i32>>> {
        let given = [
            (Sense::Force, force.is_some()),
            (Sense::Acceleration, acceleration.is_some()),
            (Sense::Edge, edge_age.is_some() && edge_up.is_some()),
        ];
        if let Some(sense) = self.sense
            && given.iter().any(|(of, given)| *of == sense && !given)
        {
            let text = format!("the estimator needs {} beside the counts", sense.text());
            return Err(PyValueError::new_err(text));
        }
        let counts = counts.as_array();
        let (force, acceleration) = (force.as_ref(), acceleration.as_ref());
        let (force, acceleration) =
            (force.map(|a| a.as_array()), acceleration.map(|a| a.as_array()));
        let (age, up) =
            (edge_age.as_ref().map(|a| a.as_array()), edge_up.as_ref().map(|a| a.as_array()));
        let lengths = [
            force.map(|a| a.len()),
            acceleration.map(|a| a.len()),
            age.map(|a| a.len()),
            up.map(|a| a.len()),
        ];
        if lengths.into_iter().flatten().any(|length| length != counts.len()) {
            return Err(PyValueError::new_err("what is sensed has not as many values as counts"));
        }
        let (parameters, mut sampler) = (&self.parameters, self.sampler);
        let mut velocities = Vec::with_capacity(counts.len());
        let mut at = |n: usize| {
            let count = counts[n];
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a counter of 32 bits"
            )]
            let reading = count as u32;
            let sampler =
                sampler.get_or_insert_with(|| Sampler::new(reading, CounterWidth::Bits32));
            let edge = match (age, up) {
                // an age below 0: no edge yet
                (Some(age), Some(up)) => {
                    u32::try_from(age[n]).ok().map(|age| Edge { age, up: up[n] })
                }
                _ => None,
            };
            let senses = Senses {
                force: force.map_or(Force::ZERO, |bits| Force::saturating_from_bits(bits[n])),
                acceleration: acceleration
                    .map_or(Acceleration::ZERO, |bits| Acceleration::saturating_from_bits(bits[n])),
                edge,
            };
            sampler.sense(parameters, reading, &senses).motion.velocity.bits()
        };
        while velocities.len() < counts.len() {
            let end = counts.len().min(velocities.len() + BLOCK);
            py.detach(|| velocities.extend((velocities.len()..end).map(&mut at)));
            py.check_signals()?; // which leaves the state as it was
        }
        self.sampler = sampler;
        Ok(velocities.into_pyarray(py))
    }
}
