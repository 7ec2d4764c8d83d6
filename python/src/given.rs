//! Converts the arguments that a caller in Python gives.

use std::{path::PathBuf, sync::Arc};

use pyo3::{
    exceptions::PyTypeError,
    inspect::PyStaticExpr,
    prelude::*,
    type_hint_identifier, type_hint_subscript, type_hint_union,
    types::{PyBytes, PyString},
};
use sim_loop::scene::NamedScene;

use crate::scene::Scene;

const ITERABLE: PyStaticExpr = type_hint_identifier!("collections.abc", "Iterable");
const TEXT: PyStaticExpr = type_hint_identifier!("builtins", "str");
const INT: PyStaticExpr = type_hint_identifier!("builtins", "int");

/// A scene that the caller gives.
pub struct Given(pub Arc<NamedScene>);

impl FromPyObject<'_, '_> for Given {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = <Scene as pyo3::PyTypeInfo>::TYPE_HINT;

    fn extract(of: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        let scene = of.cast::<Scene>().map_err(|_| {
            let given = of.repr().map_or_else(|_| "this".into(), |text| text.to_string());
            let name = if of.is_instance_of::<PyString>() { &given } else { "name or path" };
            PyTypeError::new_err(format!("{given} is no scene, allowed zwidth.Scene.load({name})"))
        })?;
        Ok(Self(Arc::clone(&scene.get().0)))
    }
}

/// A list or an array of items that the caller gives. A text is not accepted as a list.
pub struct Several<T>(pub Vec<T>);

pub type Numbers = Several<f64>;
pub type Texts = Several<String>;

/// The type of one item in [`Several`].
pub trait Item: for<'a, 'py> FromPyObject<'a, 'py> {
    /// Name of the items in an error message.
    const NAMES: &str;
}

impl Item for f64 {
    const NAMES: &str = "numbers";
}

impl Item for String {
    const NAMES: &str = "names";
}

impl<T: Item> FromPyObject<'_, '_> for Several<T> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_subscript!(ITERABLE, T::INPUT_TYPE);

    fn extract(of: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        several(&of, T::NAMES).map(Self)
    }
}

/// The items of an argument that is not a text.
pub fn several<T: for<'a, 'py> FromPyObject<'a, 'py>>(
    of: &Bound<'_, PyAny>,
    names: &str,
) -> PyResult<Vec<T>> {
    let refused = || {
        let given = of.repr().map_or_else(|_| "this".into(), |text| text.to_string());
        PyTypeError::new_err(format!("{given}, allowed several {names}: a list or an array"))
    };
    if of.is_instance_of::<PyString>() || of.is_instance_of::<PyBytes>() {
        return Err(refused());
    }
    let items = of.try_iter().map_err(|_| refused())?;
    items.map(|item| item?.extract().map_err(Into::into)).collect()
}

/// A callable of the caller. It gets the number of finished pieces of work and the number of all pieces.
pub struct Progress(pub Py<PyAny>);

impl FromPyObject<'_, '_> for Progress {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_subscript!(
        type_hint_identifier!("collections.abc", "Callable"),
        PyStaticExpr::List { elts: &[INT, INT] },
        type_hint_identifier!("builtins", "object")
    );

    fn extract(of: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        Ok(Self(of.to_owned().unbind()))
    }
}

/// A path that the caller gives.
pub struct Place(pub PathBuf);

impl FromPyObject<'_, '_> for Place {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr =
        type_hint_union!(TEXT, type_hint_subscript!(type_hint_identifier!("os", "PathLike"), TEXT));

    fn extract(of: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        of.extract().map(Self)
    }
}
