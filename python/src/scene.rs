//! Scenes.

use std::{path::PathBuf, sync::Arc};

use pyo3::{
    IntoPyObjectExt as _,
    exceptions::{PyRuntimeError, PyTypeError, PyValueError},
    prelude::*,
    types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString},
};
use serde::Serialize;
use sim_loop::scene::NamedScene;
use toml::{Table, Value};

use crate::work::raised;

/// A device, its controller and its experiments, checked.
#[pyclass(frozen, module = "zwidth._native")]
pub struct Scene(pub Arc<NamedScene>);

impl From<NamedScene> for Scene {
    fn from(scene: NamedScene) -> Self {
        Self(Arc::new(scene))
    }
}

#[pymethods]
impl Scene {
    /// A built-in scene by its name, or a scene file by its path.
    #[staticmethod]
    fn load(name_or_path: PathBuf) -> PyResult<Self> {
        let text =
            name_or_path.to_str().ok_or_else(|| PyValueError::new_err("the path is not UTF-8"))?;
        NamedScene::load(text).map(Self::from).map_err(raised)
    }

    /// A scene from the text of a scene file.
    #[staticmethod]
    #[pyo3(signature = (text, name = "scene"))]
    fn parse(text: String, name: &str) -> PyResult<Self> {
        NamedScene::parse(name.into(), text, name).map(Self::from).map_err(raised)
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// The text that it was read from.
    #[getter]
    fn text(&self) -> &str {
        &self.0.text
    }

    /// The scene as the text of a scene file, with every default written out; a rotary one as it was read.
    fn to_toml(&self) -> PyResult<String> {
        if self.0.scene.units.is_rotary() {
            return Ok(self.0.text.clone());
        }
        toml::to_string(&self.0.scene).map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }

    /// The scene as nested dictionaries, with every default.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialized(py, &self.0.scene)
    }

    /// Another scene with some values exchanged: dotted keys to values, a table at once or a key of it; None leaves
    /// a key or table out.
    fn replaced(&self, changes: &Bound<'_, PyDict>) -> PyResult<Self> {
        let mut table = self.table()?;
        self.keep_curve(&mut table);
        for (key, value) in changes {
            let key: String = key.extract()?;
            change(&mut table, &key, &value)?;
        }
        let text =
            toml::to_string(&table).map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
        NamedScene::parse(self.0.name.clone(), text, &self.0.name).map(Self::from).map_err(raised)
    }

    fn __repr__(&self) -> String {
        format!("Scene({:?})", self.0.name)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0.scene == other.0.scene
    }

    /// The text with the path of a curve such that it is found without the scene's own file.
    fn portable_text(&self) -> PyResult<String> {
        if self.0.files.len() < 2 {
            return Ok(self.0.text.clone());
        }
        let mut table = self.table()?;
        self.keep_curve(&mut table);
        toml::to_string(&table).map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }
}

impl Scene {
    fn table(&self) -> PyResult<Table> {
        self.0
            .text
            .parse()
            .map_err(|error: toml::de::Error| PyValueError::new_err(error.to_string()))
    }

    /// A text that is read without its file finds the curve by its whole path.
    fn keep_curve(&self, table: &mut Table) {
        let (Some(curve), Some(Value::Table(hit))) =
            (self.0.files.get(1), table.get_mut("wall_hit"))
        else {
            return;
        };
        let whole = std::path::absolute(curve).unwrap_or_else(|_| curve.clone());
        hit.insert("felt_curve".into(), Value::String(whole.to_string_lossy().into_owned()));
    }
}

/// Sets `value` at the dotted `key`, or leaves the key out.
fn change(table: &mut Table, key: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let mut parts: Vec<&str> = key.split('.').collect();
    let last = parts.pop().filter(|last| !last.is_empty());
    let last = last.ok_or_else(|| PyValueError::new_err("an empty key"))?;
    let mut at = table;
    for part in parts {
        let entry = at.entry(part).or_insert_with(|| Value::Table(Table::new()));
        at = match entry {
            Value::Table(table) => table,
            _ => return Err(PyValueError::new_err(format!("{key}: {part} is no table"))),
        };
    }
    if value.is_none() {
        at.remove(last);
    } else {
        at.insert(last.into(), of_python(value)?);
    }
    Ok(())
}

pub fn of_python(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    Ok(if value.is_instance_of::<PyBool>() {
        Value::Boolean(value.extract()?)
    } else if value.is_instance_of::<PyInt>() {
        Value::Integer(value.extract()?)
    } else if value.is_instance_of::<PyFloat>() {
        Value::Float(value.extract()?)
    } else if value.is_instance_of::<PyString>() {
        Value::String(value.extract()?)
    } else if let Ok(table) = value.cast::<PyDict>() {
        let pairs = table.iter().map(|(key, value)| Ok((key.extract()?, of_python(&value)?)));
        Value::Table(pairs.collect::<PyResult<Table>>()?)
    } else if let Ok(item) = value.getattr("item")
        && value.getattr("ndim").is_ok_and(|ndim| ndim.extract::<usize>().is_ok_and(|n| n == 0))
    {
        return of_python(&item.call0()?); // a number of numpy's
    } else if let Ok(items) = value.try_iter() {
        let items = items.map(|item| of_python(&item?));
        Value::Array(items.collect::<PyResult<_>>()?)
    } else {
        let kind = value.get_type().name()?;
        return Err(PyTypeError::new_err(format!("a scene holds no {kind}")));
    })
}

/// The dictionary of what is an object in the command line's JSON, with its keys; what is null there is left out.
pub fn serialized<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let table =
        Table::try_from(value).map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
    to_python(py, &Value::Table(table))
}

pub fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match value {
        Value::Boolean(value) => value.into_bound_py_any(py),
        Value::Integer(value) => value.into_bound_py_any(py),
        Value::Float(value) => value.into_bound_py_any(py),
        Value::String(value) => value.into_bound_py_any(py),
        Value::Datetime(value) => value.to_string().into_bound_py_any(py),
        Value::Array(items) => {
            let items =
                items.iter().map(|item| to_python(py, item)).collect::<PyResult<Vec<_>>>()?;
            Ok(PyList::new(py, items)?.into_any())
        }
        Value::Table(table) => {
            let dict = PyDict::new(py);
            for (key, value) in table {
                dict.set_item(key, to_python(py, value)?)?;
            }
            Ok(dict.into_any())
        }
    }
}
