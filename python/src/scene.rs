//! The Python class `Scene`.

use std::{
    hash::{DefaultHasher, Hash as _, Hasher as _},
    sync::Arc,
};

use pyo3::{
    IntoPyObjectExt as _,
    exceptions::{PyAttributeError, PyRuntimeError, PyTypeError, PyValueError},
    prelude::*,
    types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString},
};
use serde::Serialize;
use sim_loop::scene::NamedScene;
use toml::{Table, Value};

use crate::{
    given::Place,
    result::{Any, Keys},
    work::raised,
};

/// A checked device with its controller and experiments.
///
/// Made by `load`, `parse` and `replace`. A scene never changes. Scenes can be compared and pickled.
#[pyclass(frozen, module = "zwidth")]
pub struct Scene(pub Arc<NamedScene>);

impl From<NamedScene> for Scene {
    fn from(scene: NamedScene) -> Self {
        Self(Arc::new(scene))
    }
}

#[pymethods]
impl Scene {
    /// Load a built-in scene or a scene file.
    ///
    /// Parameters
    /// ----------
    /// name_or_path : str or path
    ///     One of `zwidth.SCENES`, or the path of a TOML file.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     There is no such scene, or the file has a value that is not allowed. The message has file, line, key, value
    ///     and what is allowed.
    ///
    /// Examples
    /// --------
    /// >>> scene = Scene.load("paper-1um")
    /// >>> scene
    /// Scene('paper-1um')
    /// >>> scene.to_dict()["encoder"]["resolution_m"]
    /// 1e-06
    #[staticmethod]
    fn load(name_or_path: Place) -> PyResult<Self> {
        let text = name_or_path.0.to_str();
        let text = text.ok_or_else(|| PyValueError::new_err("the path is not UTF-8"))?;
        NamedScene::load(text).map(Self::from).map_err(raised)
    }

    /// Read a scene from the text of a scene file. `name` is its name in results and errors.
    #[staticmethod]
    #[pyo3(signature = (text, name = "scene"))]
    fn parse(text: String, name: &str) -> PyResult<Self> {
        NamedScene::parse(name.into(), text, name).map(Self::from).map_err(raised)
    }

    /// Name of the built-in scene, or of the file without its ending.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// The text of the scene file, with comments.
    #[getter]
    fn text(&self) -> &str {
        &self.0.text
    }

    /// The scene as the text of a scene file, with every default. For a rotary scene, this is the text that was read.
    fn to_toml(&self) -> PyResult<String> {
        if self.0.scene.units.is_rotary() {
            return Ok(self.0.text.clone());
        }
        toml::to_string(&self.0.scene).map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }

    /// The scene as nested dictionaries, with all defaults. For a rotary scene all values are at the handle, and the
    /// dictionary also has the scene's table `rotary` as it was read.
    fn to_dict(&self, py: Python<'_>) -> PyResult<Keys> {
        let keys = serialized(py, &self.0.scene)?;
        if let Some(rotary) = self.0.table().map_err(raised)?.get("rotary") {
            keys.set_item("rotary", to_python(py, rotary)?)?;
        }
        Ok(Keys(keys.unbind()))
    }

    /// Copy the scene with some values changed.
    ///
    /// Parameters
    /// ----------
    /// changes : mapping, optional
    ///     Dotted keys with values, for example `{"encoder.resolution_m": 2e-6}`. The value None removes the key. A
    ///     dictionary replaces a whole table.
    /// **tables : mapping
    ///     Keys of a table with values, for example `encoder={"resolution_m": 2e-6}`. Other keys of the table do not
    ///     change.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     The changed scene is not allowed. The error gives key, value and what is allowed.
    ///
    /// Examples
    /// --------
    /// >>> coarse = Scene.load("paper-1um").replace({"encoder.resolution_m": 4e-6})
    /// >>> coarse.to_dict()["encoder"]["resolution_m"]
    /// 4e-06
    /// >>> coarse.replace(encoder={"resolution_m": 0})
    /// Traceback (most recent call last):
    ///     ...
    /// ValueError: paper-1um: encoder.resolution_m is 0, allowed 0.00000001 to 0.001
    #[pyo3(signature = (changes = None, /, **tables: "object"))]
    fn replace(
        &self,
        py: Python<'_>,
        changes: Option<Keys>,
        tables: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut table = self.0.table().map_err(raised)?;
        let pairs = |of: &Bound<'_, PyAny>| -> PyResult<Vec<(String, Py<PyAny>)>> {
            of.call_method0("items")?.try_iter()?.map(|pair| pair?.extract()).collect()
        };
        for (key, value) in changes.map_or(Ok(vec![]), |changes| pairs(changes.0.bind(py)))? {
            change(&mut table, &key, value.bind(py))?;
        }
        for (name, keys) in tables.into_iter().flatten() {
            for (key, value) in pairs(&keys)? {
                change(&mut table, &format!("{name}.{key}"), value.bind(py))?;
            }
        }
        let text = toml::to_string(&table);
        let text = text.map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
        NamedScene::parse(self.0.name.clone(), text, &self.0.name).map(Self::from).map_err(raised)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Scene({})", PyString::new(py, &self.0.name).repr()?))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0.scene == other.0.scene
    }

    fn __hash__(&self) -> PyResult<u64> {
        let mut hasher = DefaultHasher::new();
        self.to_toml()?.hash(&mut hasher);
        Ok(hasher.finish())
    }

    fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<Any> {
        let own = slf.get();
        let parts = (slf.get_type().getattr("parse")?, (own.portable_text()?, own.name()));
        parts.into_py_any(slf.py()).map(Any)
    }

    /// The scene's text. The path of its curve file is changed so that it is valid from any folder.
    #[pyo3(name = "_portable_text")]
    fn portable_text(&self) -> PyResult<String> {
        if self.0.files.len() < 2 {
            return Ok(self.0.text.clone());
        }
        let table = self.0.table().map_err(raised)?;
        toml::to_string(&table).map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }

    fn __setattr__(&self, name: &str, _value: &Bound<'_, PyAny>) -> PyResult<()> {
        Err(PyAttributeError::new_err(format!(
            "a Scene does not change; scene.replace makes another one (tried to set {name})"
        )))
    }
}

/// Sets the dotted `key` to `value`. None removes the key.
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
        return of_python(&item.call0()?); // a number of numpy
    } else if let Ok(items) = value.try_iter() {
        let items = items.map(|item| of_python(&item?));
        Value::Array(items.collect::<PyResult<_>>()?)
    } else {
        let kind = value.get_type().name()?;
        return Err(PyTypeError::new_err(format!("a scene holds no {kind}")));
    })
}

/// Makes a dictionary with the keys of the command line's JSON object. Keys whose value is null are left out.
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
