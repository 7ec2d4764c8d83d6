//! Applies the core's velocity estimators to recorded counts.

use std::sync::Arc;

use numpy::{
    Element, PyArrayDescrMethods as _, PyArrayMethods as _, PyReadonlyArray1, PyUntypedArray,
    PyUntypedArrayMethods as _,
};
use pyo3::{
    exceptions::PyValueError, inspect::PyStaticExpr, prelude::*, type_hint_identifier,
    types::PyDict,
};
use sim_loop::{
    error::Error,
    scene::{NamedScene, VelocityTable},
    simulation::controller::lsb_per_m_per_s,
};
use sim_studies::study::asked::{self, Names};
use toml::Value;
use zwidth::{
    CounterWidth, Design, LoopParameters, Sampler,
    units::{Acceleration, Force},
    velocity::{Edge, EstimatorName, Sense, Senses},
};

use crate::{
    given::Given,
    result::Array,
    scene::{Scene, of_python},
    work::raised,
};

/// A velocity estimator of the control core, with its state. From recorded counts the estimator computes the velocities
/// of the firmware.
///
/// Parameters
/// ----------
/// name : str
///     One of `zwidth.ESTIMATORS`.
/// scene : Scene
///     Gives sample rate and encoder, and, if the estimator needs them, mass and force.
/// cutoff : float, optional
///     Nominal cutoff, Hz. Omit it for an estimator without a cutoff.
/// **parameters
///     Other keys of a scene's `[velocity]` table. If the scene has this estimator, missing keys come from the scene.
///     Otherwise missing keys have their defaults (docs/estimators.md), and the mass is the device's mass.
///
/// Raises
/// ------
/// ValueError
///     There is no such estimator, or a parameter is out of range.
///
/// Notes ----- A copy (`copy.copy`) begins with the state of the original, and then continues independently.
///
/// Examples
/// --------
/// >>> import numpy as np
/// >>> estimator = Estimator("butterworth", Scene.load("paper-1um"), cutoff=500)
/// >>> velocity = estimator.process(np.arange(1000))  # a count a sample: 1 um * 10 kHz
/// >>> round(float(velocity[-1]), 6)
/// 0.01
#[pyclass(module = "zwidth")]
#[derive(Clone)]
pub struct Estimator {
    scene: Arc<NamedScene>,
    cutoff_hz: Option<f64>,
    parameters: LoopParameters,
    design: Design,
    sense: Option<Sense>,
    /// The sampler and the width of the counter. `None` before the first count.
    state: Option<(CounterWidth, Sampler)>,
}

/// Number of counts after which the interpreter's signals are checked. A block of this size takes some milliseconds.
const BLOCK: usize = 1 << 16;
const NAMES: Names =
    Names { cutoff: "cutoff", stiffness: "", damping: "", start_offset: "start_offset" };

/// The table `[velocity]` for the estimator of this name. If the scene has this estimator, the table has the scene's
/// own keys. Otherwise the table has the defaults and the device's mass.
fn velocity_table(name: &str, scene: &NamedScene) -> PyResult<toml::Table> {
    let found = EstimatorName::ALL.iter().find(|known| known.text() == name);
    let found = found.ok_or_else(|| {
        PyValueError::new_err(match EstimatorName::replacing(name) {
            Some(other) => format!("estimator {name:?} is no more: use {other}"),
            None => {
                let all: Vec<&str> = EstimatorName::ALL.iter().map(|name| name.text()).collect();
                format!("there is no estimator {name:?}, allowed {}", all.join(", "))
            }
        })
    })?;
    let internal = |error: toml::ser::Error| raised(Error::Internal(error.to_string()));
    let table =
        |filter: VelocityTable| toml::Table::try_from(filter.with_cutoff(None)).map_err(internal);
    let (mut table, own) = (table(found.defaults().into())?, table(scene.scene.velocity)?);
    let device = toml::Table::try_from(scene.scene.device).map_err(internal)?;
    let is_own = table.keys().eq(own.keys()) && table["estimator"] == own["estimator"];
    for (key, value) in &mut table {
        if let Some(of_device) = device.get(key) {
            value.clone_from(of_device);
        }
        if is_own && !["prewarp", "order", "degree"].contains(&key.as_str()) {
            value.clone_from(&own[key]);
        }
    }
    Ok(table)
}

/// A copy of the scene with another table `[velocity]`. This cutoff is its only cutoff.
fn with_estimator(
    scene: &NamedScene,
    velocity: toml::Table,
    cutoff: Option<f64>,
) -> PyResult<NamedScene> {
    let mut other = scene.clone();
    let internal = |error: toml::ser::Error| raised(Error::Internal(error.to_string()));
    other.scene.velocity = Value::Table(velocity)
        .try_into()
        .map_err(|error: toml::de::Error| PyValueError::new_err(error.message().to_owned()))?;
    let hit = asked::hit(&other, cutoff, None, 0.0, NAMES).map_err(raised)?;
    if let Some(cutoff_hz) = hit.velocity.cutoff_hz() {
        other.scene.sweep.cutoffs_hz = vec![cutoff_hz];
    }
    let text = toml::to_string(&other.scene).map_err(internal)?;
    NamedScene::parse(other.name.clone(), text, &other.name).map_err(raised)
}

/// An array, or another Python object that converts to one.
pub struct ArrayLike<'py>(Bound<'py, PyUntypedArray>);

impl<'py> FromPyObject<'_, 'py> for ArrayLike<'py> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_identifier!("numpy.typing", "ArrayLike");

    fn extract(of: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let array = of.py().import("numpy")?.call_method1("asarray", (of,))?;
        Ok(Self(array.cast_into()?))
    }
}

impl<'py> ArrayLike<'py> {
    /// Size of one number in bytes. `None` if the numbers are not whole.
    fn whole(&self) -> Option<usize> {
        let dtype = self.0.dtype();
        matches!(dtype.kind(), b'i' | b'u').then(|| dtype.itemsize())
    }

    /// Converts the numbers to this type. Each number must fit.
    fn numbers<T: Element>(
        &self,
        length: usize,
        name: &str,
        allowed: &str,
    ) -> PyResult<PyReadonlyArray1<'py, T>> {
        let py = self.0.py();
        let refused =
            |given: &dyn std::fmt::Display| format!("{name} is {given}, allowed {allowed}");
        let is_flag = T::get_dtype(py).kind() == b'b';
        if self.whole().is_none() && !(is_flag && self.0.dtype().kind() == b'b') {
            return Err(PyValueError::new_err(refused(&self.0.dtype())));
        }
        let made = self.0.call_method1("astype", (T::get_dtype(py),))?;
        let same = made.call_method1("__eq__", (&self.0,))?.call_method0("all")?;
        if !same.is_truthy()? {
            return Err(PyValueError::new_err(refused(&"out of range")));
        }
        let made = made.cast_into::<numpy::PyArray1<T>>().map_err(|_| {
            PyValueError::new_err(refused(&format_args!("of {} dimensions", self.0.ndim())))
        })?;
        if made.len() != length {
            return Err(PyValueError::new_err("what is sensed has not as many values as counts"));
        }
        Ok(made.readonly())
    }
}

/// Text that describes the format of the inputs other than the counts.
const FORMAT: &str = "whole numbers of 32 bits in the core's format (docs/estimators.md)";

#[pymethods]
impl Estimator {
    #[new]
    #[pyo3(signature = (name, scene, *, cutoff = None, **parameters: "object"))]
    fn new(
        name: &str,
        scene: Given,
        cutoff: Option<f64>,
        parameters: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut velocity = velocity_table(name, &scene.0)?;
        for (key, value) in parameters.into_iter().flatten() {
            velocity.insert(key.extract()?, of_python(&value)?);
        }
        let scene = with_estimator(&scene.0, velocity, cutoff)?;
        let hit = asked::hit(&scene, cutoff, None, 0.0, NAMES).map_err(raised)?;
        let design = scene.scene.design();
        let parameters = scene
            .scene
            .settings(hit.velocity, hit.stiffness_n_per_m, hit.damping_n_s_per_m)
            .build(&design)
            .map_err(|error| raised(Error::input(error)))?;
        let sense = scene.scene.velocity.sense();
        let scene = Arc::new(scene);
        let cutoff_hz = hit.velocity.cutoff_hz();
        Ok(Self { scene, cutoff_hz, parameters, design, sense, state: None })
    }

    /// The scene with this estimator. This cutoff is its only cutoff.
    #[getter]
    fn scene(&self) -> Scene {
        Scene(Arc::clone(&self.scene))
    }

    /// Nominal cutoff in Hz; None for an estimator without a cutoff.
    #[getter]
    fn cutoff_hz(&self) -> Option<f64> {
        self.cutoff_hz
    }

    /// The input that the estimator needs in addition to the counts: "force", "acceleration", "edge times" or None.
    #[getter]
    fn needs(&self) -> Option<&'static str> {
        self.sense.map(Sense::text)
    }

    /// Velocity that one LSB of the core's format stands for, in m/s.
    #[getter]
    fn lsb_m_per_s(&self) -> f64 {
        1.0 / lsb_per_m_per_s(&self.design)
    }

    /// Forget all counts, and begin again.
    fn reset(&mut self) {
        self.state = None;
    }

    fn __copy__(&self) -> Self {
        self.clone()
    }

    fn __deepcopy__(&self, _memo: &Bound<'_, PyAny>) -> Self {
        self.clone()
    }

    /// Velocities at these counts. The next call continues after the last count of this call.
    ///
    /// Parameters
    /// ----------
    /// counts : array of int
    ///     The encoder's counter at each sample. Wraps are corrected: at 2^16 for numbers of 16 bits, at 2^32 for
    ///     longer numbers.
    /// force, acceleration : array of int, optional
    ///     Mean force and mean acceleration since the last sample, in the core's format (docs/estimators.md).
    /// edge_age, edge_up : array, optional
    ///     `edge_age` is the time from the latest edge to the sample, in 2^-16 samples. Before the first edge the value
    ///     is below 0. `edge_up` says whether the count increased at this edge.
    /// bits : bool
    ///     Return the core's integers instead of m/s.
    ///
    /// Returns
    /// -------
    /// ndarray
    ///     Velocity, m/s (float64), or bits (int32). The velocity is 0 at the first count.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     An input that the estimator needs is missing, has no whole numbers, or has another length. Or the counter's
    ///     width does not exist, or differs from the previous block.
    ///
    /// Notes
    /// -----
    /// After an exception, also after Ctrl-C, the state is as before the call.
    ///
    /// Examples
    /// --------
    /// >>> import numpy as np
    /// >>> estimator = Estimator("butterworth", Scene.load("paper-1um"), cutoff=500)
    /// >>> estimator.process(np.arange(4)).round(6).tolist()
    /// [0.0, 0.000198, 0.000903, 0.002077]
    /// >>> estimator.process(np.arange(4, 8)).round(6).tolist()  # it continues
    /// [0.00346, 0.004868, 0.00618, 0.007328]
    #[pyo3(signature = (
        counts, *, force = None, acceleration = None, edge_age = None, edge_up = None, bits = false
    ))]
    fn process(
        &mut self,
        py: Python<'_>,
        counts: ArrayLike<'_>,
        force: Option<ArrayLike<'_>>,
        acceleration: Option<ArrayLike<'_>>,
        edge_age: Option<ArrayLike<'_>>,
        edge_up: Option<ArrayLike<'_>>,
        bits: bool,
    ) -> PyResult<Velocities> {
        let width = match counts.whole() {
            Some(2) => CounterWidth::Bits16,
            Some(4 | 8) => CounterWidth::Bits32,
            _ => {
                let given = counts.0.dtype();
                let text =
                    format!("counts are {given}, allowed whole numbers of 16, 32 or 64 bits");
                return Err(PyValueError::new_err(text));
            }
        };
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
        if self.state.is_some_and(|(before, _)| before != width) {
            let text = "counts have another width than those before, which wrap elsewhere: reset() begins anew";
            return Err(PyValueError::new_err(text));
        }
        let counts = py
            .import("numpy")?
            .call_method1("ascontiguousarray", (&counts.0, numpy::dtype::<i64>(py)))?;
        let counts = counts.cast_into::<numpy::PyArray1<i64>>();
        let counts = counts.map_err(|_| PyValueError::new_err("counts have not one dimension"))?;
        let (counts, length) = (counts.readonly(), counts.len());
        let force = force.map(|a| a.numbers::<i32>(length, "force", FORMAT)).transpose()?;
        let acceleration =
            acceleration.map(|a| a.numbers::<i32>(length, "acceleration", FORMAT)).transpose()?;
        let whole = "whole numbers of 2^-16 samples";
        let age = edge_age.map(|a| a.numbers::<i64>(length, "edge_age", whole)).transpose()?;
        let up =
            edge_up.map(|a| a.numbers::<bool>(length, "edge_up", "truth values")).transpose()?;
        let counts = counts.as_array();
        let (force, acceleration) =
            (force.as_ref().map(|a| a.as_array()), acceleration.as_ref().map(|a| a.as_array()));
        let (age, up) = (age.as_ref().map(|a| a.as_array()), up.as_ref().map(|a| a.as_array()));
        let (parameters, mut state) = (&self.parameters, self.state);
        let lsb_m_per_s = self.lsb_m_per_s();
        let (mut raw, mut metres): (Vec<i32>, Vec<f64>) = (vec![], vec![]);
        let mut at = |n: usize| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a counter of at most 32 bits"
            )]
            let reading = counts[n] as u32;
            let (_, sampler) = state.get_or_insert_with(|| (width, Sampler::new(reading, width)));
            let edge = match (age, up) {
                // A negative age means that there was no edge yet.
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
        let blocks = (0..counts.len()).step_by(BLOCK).map(|n| n..counts.len().min(n + BLOCK));
        for block in blocks {
            py.detach(|| match bits {
                true => raw.extend(block.map(&mut at)),
                false => metres.extend(block.map(|n| f64::from(at(n)) * lsb_m_per_s)),
            });
            py.check_signals()?; // an exception leaves the state as it was
        }
        let made = if bits {
            Velocities::Bits(Array::writable(py, raw))
        } else {
            Velocities::Metres(Array::writable(py, metres))
        };
        self.state = state;
        Ok(made)
    }
}

/// The result of [`Estimator::process`]: velocities in m/s, or bits.
#[derive(IntoPyObject)]
pub enum Velocities {
    Metres(Array<f64>),
    Bits(Array<i32>),
}
