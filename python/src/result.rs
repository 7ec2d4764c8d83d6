//! What results in Python are made of: frozen classes, read-only arrays, tuples and tables.

use std::borrow::Borrow;

use numpy::{Element, IntoPyArray as _, PyArrayDyn, PyArrayMethods as _};
use pyo3::{
    IntoPyObjectExt as _, PyClass,
    inspect::PyStaticExpr,
    prelude::*,
    type_hint_identifier, type_hint_subscript, type_hint_union,
    types::{IntoPyDict as _, PyDict, PyTuple},
};
use sim_studies::table::{Cell, Column, Kind};

/// Defines a frozen Python class. Its fields are the attributes. The constructor has an argument for each field. The
/// text of an object shows the short fields. Objects can be pickled. The first word is the kind of class. Objects of a
/// `value` are equal if their fields are equal. A `table` writes its own method `columns`. A `table(FIELD)` has the
/// columns of this field. In `arrays`, each attribute is a column.
macro_rules! result {
    (table($table:ident) $(#[$of:meta])* $name:ident $fields:tt $($methods:tt)*) => {
        $crate::result::result! { table $(#[$of])* $name $fields
            /// The columns of the table.
            fn columns(&self, py: Python<'_>) -> PyResult<$crate::result::Keys> {
                self.$table.columns(py)
            }

            $($methods)*
        }
    };
    (arrays $(#[$of:meta])* $name:ident $fields:tt) => {
        $crate::result::result! { table $(#[$of])* $name $fields
            /// The columns of the table.
            fn columns(slf: &Bound<'_, Self>) -> PyResult<$crate::result::Keys> {
                $crate::result::attributes(slf)
            }
        }
    };
    ($kind:ident $(#[$of:meta])* $name:ident { $($(#[$at:meta])* $field:ident: $type:ty,)* } $($methods:tt)*) => {
        $(#[$of])*
        #[pyclass(frozen, get_all, module = "zwidth")]
        pub struct $name { $($(#[$at])* pub $field: $type,)* }

        impl $crate::result::Fields for $name {
            const FIELDS: &[&str] = &[$(stringify!($field)),*];
        }

        $crate::result::methods! {
            $kind $name { $($field: $type,)* } $($methods)*
        }
    };
}

macro_rules! methods {
    (value $name:ident $fields:tt $($methods:tt)*) => {
        $crate::result::methods! { plain $name $fields
            fn __eq__(slf: &Bound<'_, Self>, other: &Bound<'_, PyAny>) -> PyResult<bool> {
                $crate::result::equal(slf, other)
            }

            fn __hash__(slf: &Bound<'_, Self>) -> PyResult<isize> {
                $crate::result::fields(slf)?.hash()
            }

            $($methods)*
        }
    };
    (table $name:ident $fields:tt $($methods:tt)*) => {
        $crate::result::methods! { plain $name $fields
            /// The table as a `pyarrow.Table`; needs pyarrow.
            fn to_arrow(slf: &Bound<'_, Self>) -> PyResult<$crate::result::Arrow> {
                $crate::result::columns_to(slf, "pyarrow", "table").map($crate::result::Arrow)
            }

            /// The table as a `pandas.DataFrame`; needs pandas.
            fn to_pandas(slf: &Bound<'_, Self>) -> PyResult<$crate::result::Pandas> {
                $crate::result::columns_to(slf, "pandas", "DataFrame").map($crate::result::Pandas)
            }

            $($methods)*
        }
    };
    (plain $name:ident { $($field:ident: $type:ty,)* } $($methods:tt)*) => {
        #[pymethods]
        impl $name {
            #[new]
            fn new($($field: $type),*) -> Self {
                Self { $($field),* }
            }

            /// The attributes by name, for `vars()`.
            #[getter]
            fn __dict__(slf: &Bound<'_, Self>) -> PyResult<$crate::result::Keys> {
                $crate::result::attributes(slf)
            }

            fn __repr__(slf: &Bound<'_, Self>) -> PyResult<String> {
                $crate::result::text(slf)
            }

            fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<$crate::result::Any> {
                let parts = (slf.get_type(), $crate::result::fields(slf)?);
                Ok($crate::result::Any(pyo3::IntoPyObjectExt::into_py_any(parts, slf.py())?))
            }

            $($methods)*
        }
    };
}
pub(crate) use {methods, result};

/// A Python class whose objects can be made from their attributes.
pub trait Fields: PyClass {
    /// Names of the attributes.
    const FIELDS: &[&str];
}

/// Makes an object of the class from attributes by name. A missing attribute is None.
pub fn made<T: Fields>(attributes: &Bound<'_, PyAny>) -> PyResult<Py<T>> {
    let attributes = attributes.cast::<PyDict>()?;
    for name in T::FIELDS {
        if !attributes.contains(name)? {
            attributes.set_item(name, attributes.py().None())?;
        }
    }
    let class = attributes.py().get_type::<T>();
    Ok(class.call((), Some(attributes))?.cast_into::<T>()?.unbind())
}

/// The attributes in the order of [`Fields::FIELDS`].
pub fn fields<'py, T: Fields>(of: &Bound<'py, T>) -> PyResult<Bound<'py, PyTuple>> {
    let values = T::FIELDS.iter().map(|name| of.as_any().getattr(*name));
    PyTuple::new(of.py(), values.collect::<PyResult<Vec<_>>>()?)
}

pub fn equal<T: Fields>(of: &Bound<'_, T>, other: &Bound<'_, PyAny>) -> PyResult<bool> {
    match other.cast::<T>() {
        Ok(other) => fields(of)?.eq(fields(other)?),
        Err(_) => Ok(false),
    }
}

/// The attributes by name.
pub fn attributes<T: Fields>(of: &Bound<'_, T>) -> PyResult<Keys> {
    let values = T::FIELDS.iter().map(|name| Ok((*name, of.as_any().getattr(*name)?)));
    columns(of.py(), values.collect::<PyResult<Vec<_>>>()?)
}

/// Largest number of characters with which an attribute is shown in `text`. A longer attribute is shown by its type and
/// size.
const SHORT: usize = 120;

/// The object's text. It shows an array by its shape, and a long attribute by its type and size.
pub fn text<T: Fields>(of: &Bound<'_, T>) -> PyResult<String> {
    let told = T::FIELDS.iter().map(|name| {
        let value = of.as_any().getattr(*name)?;
        let kind = value.get_type().name()?;
        let text = if let Ok(shape) = value.getattr("shape") {
            format!("<{} {}>", value.getattr("dtype")?, shape.repr()?)
        } else {
            let text = value.repr()?.to_string();
            match value.len() {
                Ok(length) if text.len() > SHORT => format!("<{kind} of {length}>"),
                _ => text,
            }
        };
        Ok(format!("{name}={text}"))
    });
    Ok(format!(
        "{}({})",
        of.as_any().get_type().name()?,
        told.collect::<PyResult<Vec<_>>>()?.join(", ")
    ))
}

/// Calls the Python function `module.name` with the columns of a table.
pub fn columns_to(of: &Bound<'_, impl PyClass>, module: &str, name: &str) -> PyResult<Py<PyAny>> {
    let columns = of.as_any().call_method0("columns")?;
    of.py().import(module)?.call_method1(name, (columns,)).map(Bound::unbind)
}

/// Defines types for Python objects. The stubs get the given type hint.
macro_rules! typed {
    ($($name:ident: $hint:expr;)*) => { $(
        pub struct $name(pub Py<PyAny>);

        impl<'py> IntoPyObject<'py> for $name {
            type Target = PyAny;
            type Output = Bound<'py, PyAny>;
            type Error = std::convert::Infallible;
            const OUTPUT_TYPE: PyStaticExpr = $hint;

            fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Self::Error> {
                Ok(self.0.into_bound(py))
            }
        }

        impl<'py> IntoPyObject<'py> for &$name {
            type Target = PyAny;
            type Output = Bound<'py, PyAny>;
            type Error = std::convert::Infallible;
            const OUTPUT_TYPE: PyStaticExpr = $hint;

            fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Self::Error> {
                Ok(self.0.bind(py).clone())
            }
        }

        impl FromPyObject<'_, '_> for $name {
            type Error = std::convert::Infallible;
            const INPUT_TYPE: PyStaticExpr = $hint;

            fn extract(of: Borrowed<'_, '_, PyAny>) -> Result<Self, Self::Error> {
                Ok(Self(of.to_owned().unbind()))
            }
        }
    )* };
}

const ANY: PyStaticExpr = type_hint_identifier!("typing", "Any");
const TEXT: PyStaticExpr = type_hint_identifier!("builtins", "str");
const DICT: PyStaticExpr = type_hint_identifier!("builtins", "dict");

typed! {
    Any: ANY;
    Asked: type_hint_union!(
        TEXT,
        type_hint_subscript!(type_hint_identifier!("os", "PathLike"), TEXT),
        type_hint_subscript!(type_hint_identifier!("collections.abc", "Mapping"), TEXT, ANY)
    );
    Bytes: type_hint_identifier!("builtins", "bytes");
    Arrow: type_hint_identifier!("pyarrow", "Table");
    Pandas: type_hint_identifier!("pandas", "DataFrame");
    Table: type_hint_identifier!("zwidth.table", "Table");
    Keys: type_hint_subscript!(DICT, TEXT, ANY);
}

impl Table {
    /// A table from columns by name.
    pub fn new(py: Python<'_>, columns: Keys) -> PyResult<Self> {
        let class = py.import("zwidth.table")?.getattr("Table")?;
        Ok(Self(class.call1((columns,))?.unbind()))
    }

    /// A table of the studies with all its columns.
    pub fn of(py: Python<'_>, table: &sim_studies::table::Table) -> PyResult<Self> {
        Self::of_rows(py, &table.columns, &table.rows)
    }

    /// A table from rows of the studies. A missing number is NaN, and a missing text is empty.
    pub fn of_rows<C: Borrow<Column>>(
        py: Python<'_>,
        names: impl IntoIterator<Item = C>,
        rows: &[Vec<Cell>],
    ) -> PyResult<Self> {
        let named = names.into_iter().enumerate().map(|(n, column)| {
            let Column { name, kind } = column.borrow();
            let cells = rows.iter().map(|row| &row[n]);
            let values = match kind {
                Kind::Number => {
                    let number = |cell: &Cell| match cell {
                        Cell::Number(value) => *value,
                        _ => f64::NAN,
                    };
                    Array::new(py, cells.map(number).collect())?.bound(py)
                }
                Kind::Whole => {
                    let whole =
                        |cell: &Cell| if let Cell::Whole(value) = cell { *value } else { 0 };
                    Array::<u64>::new(py, cells.map(whole).collect())?.bound(py)
                }
                Kind::Flag => {
                    let flag = |cell: &Cell| matches!(cell, Cell::Flag(true));
                    Array::new(py, cells.map(flag).collect())?.bound(py)
                }
                Kind::Text => {
                    let text = |cell: &Cell| match cell {
                        Cell::Text(text) | Cell::Quoted(text) => text.to_string(),
                        _ => String::new(),
                    };
                    cells.map(text).collect::<Vec<String>>().into_bound_py_any(py)?
                }
            };
            Ok((name.to_string(), values))
        });
        let made = named.collect::<PyResult<Vec<(String, _)>>>()?.into_py_dict(py)?;
        Self::new(py, Keys(made.into_any().unbind()))
    }

    /// Columns of the table by name.
    pub fn columns(&self, py: Python<'_>) -> PyResult<Keys> {
        self.0.call_method0(py, "columns").map(Keys)
    }
}

/// The type of an array's elements.
pub trait Number: Element {
    /// The type of the array that the stubs show.
    const ARRAY: PyStaticExpr;
}

macro_rules! number {
    ($($of:ty: $name:expr;)*) => { $(
        impl Number for $of {
            const ARRAY: PyStaticExpr = type_hint_subscript!(
                type_hint_identifier!("numpy.typing", "NDArray"),
                type_hint_identifier!("numpy", $name)
            );
        }
    )* };
}
number! {
    f64: "float64"; bool: "bool_"; u8: "uint8"; u16: "uint16"; u32: "uint32"; u64: "uint64"; i32: "int32"; i64: "int64";
}

/// A read-only array of numpy.
pub struct Array<T>(Py<PyArrayDyn<T>>);

impl<T: Number> Array<T> {
    /// An array of these values, without a copy.
    pub fn new(py: Python<'_>, values: Vec<T>) -> PyResult<Self> {
        Self::of(values.into_pyarray(py).to_dyn().clone())
    }

    /// An array with one value for each row. The function `of` gives the value.
    pub fn each<R>(py: Python<'_>, rows: &[R], of: impl Fn(&R) -> T) -> PyResult<Self> {
        Self::new(py, rows.iter().map(of).collect())
    }

    /// A writable array of these values. The caller owns the array.
    pub fn writable(py: Python<'_>, values: Vec<T>) -> Self {
        Self(values.into_pyarray(py).to_dyn().clone().unbind())
    }

    pub fn shaped(py: Python<'_>, values: Vec<T>, shape: &[usize]) -> PyResult<Self> {
        Self::of(values.into_pyarray(py).reshape(shape)?)
    }

    pub fn bound<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.0.bind(py).clone().into_any()
    }

    fn of(array: Bound<'_, PyArrayDyn<T>>) -> PyResult<Self> {
        array.getattr("flags")?.setattr("writeable", false)?;
        Ok(Self(array.unbind()))
    }
}

impl<'py, T: Number> IntoPyObject<'py> for &Array<T> {
    type Target = PyArrayDyn<T>;
    type Output = Bound<'py, PyArrayDyn<T>>;
    type Error = std::convert::Infallible;
    const OUTPUT_TYPE: PyStaticExpr = T::ARRAY;

    fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0.bind(py).clone())
    }
}

impl<'py, T: Number> IntoPyObject<'py> for Array<T> {
    type Target = PyArrayDyn<T>;
    type Output = Bound<'py, PyArrayDyn<T>>;
    type Error = std::convert::Infallible;
    const OUTPUT_TYPE: PyStaticExpr = T::ARRAY;

    fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0.into_bound(py))
    }
}

impl<T: Number + 'static> FromPyObject<'_, '_> for Array<T> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = T::ARRAY;

    fn extract(of: Borrowed<'_, '_, PyAny>) -> Result<Self, Self::Error> {
        Self::of(of.cast::<PyArrayDyn<T>>()?.to_owned())
    }
}

/// An object of a class in this module. Python code may also give it as a mapping from names to attributes.
pub struct Part<T>(pub Py<T>);

impl<'py, T: Fields> IntoPyObject<'py> for &Part<T> {
    type Target = T;
    type Output = Bound<'py, T>;
    type Error = std::convert::Infallible;
    const OUTPUT_TYPE: PyStaticExpr = T::TYPE_HINT;

    fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0.bind(py).clone())
    }
}

impl<T: Fields> FromPyObject<'_, '_> for Part<T> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = T::TYPE_HINT;

    fn extract(of: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        match of.cast::<T>() {
            Ok(object) => Ok(Self(object.to_owned().unbind())),
            Err(_) => made(&of).map(Self),
        }
    }
}

/// A tuple of any length.
pub struct Tuple<T>(pub Vec<T>);

impl<T> FromIterator<T> for Tuple<T> {
    fn from_iter<I: IntoIterator<Item = T>>(items: I) -> Self {
        Self(items.into_iter().collect())
    }
}

impl<'a, 'py, T> IntoPyObject<'py> for &'a Tuple<T>
where
    &'a T: IntoPyObject<'py>,
{
    type Target = PyTuple;
    type Output = Bound<'py, PyTuple>;
    type Error = PyErr;
    const OUTPUT_TYPE: PyStaticExpr = type_hint_subscript!(
        type_hint_identifier!("builtins", "tuple"),
        <&T>::OUTPUT_TYPE,
        PyStaticExpr::Constant { value: pyo3::inspect::PyStaticConstant::Ellipsis }
    );

    fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Self::Error> {
        PyTuple::new(py, &self.0)
    }
}

impl<'py, T: for<'a> FromPyObject<'a, 'py>> FromPyObject<'_, 'py> for Tuple<T> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr =
        type_hint_subscript!(type_hint_identifier!("collections.abc", "Iterable"), T::INPUT_TYPE);

    fn extract(of: Borrowed<'_, 'py, PyAny>) -> Result<Self, Self::Error> {
        of.try_iter()?.map(|item| item?.extract().map_err(Into::into)).collect()
    }
}

/// A Python dictionary of columns. It keeps their order.
pub fn columns<'py>(
    py: Python<'py>,
    columns: impl IntoIterator<Item = (&'static str, Bound<'py, PyAny>)>,
) -> PyResult<Keys> {
    Ok(Keys(columns.into_py_dict(py)?.into_any().unbind()))
}
