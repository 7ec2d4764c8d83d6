//! What can go wrong, and the exit code that says so.

use std::{fmt, io, path::PathBuf};

/// Why a command ended without its result.
#[derive(Debug)]
pub enum Error {
    /// The user asked for something that cannot be: exit code 2. The text is one line that names
    /// where, what and what is allowed.
    Input(String),
    /// A file could not be written or read half-way: exit code 1.
    File {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Something that should not happen: exit code 1.
    Internal(String),
    /// Ctrl-C: exit code 130.
    Interrupted,
}

impl Error {
    /// An [`Error::Input`] from anything that prints.
    pub fn input(text: impl fmt::Display) -> Self {
        Self::Input(text.to_string())
    }

    /// An [`Error::File`] at `path`.
    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }

    /// The same error, with the name of what it is about in front of bad input.
    #[must_use]
    pub fn of(self, name: &str) -> Self {
        match self {
            Self::Input(text) => Self::Input(format!("{name}: {text}")),
            other => other,
        }
    }

    /// The process' exit code.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) => 2,
            Self::File { .. } | Self::Internal(_) => 1,
            Self::Interrupted => 130,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(text) | Self::Internal(text) => f.write_str(text),
            Self::File { path, source } => write!(f, "{}: {source}", path.display()),
            Self::Interrupted => f.write_str("interrupted; no file was left half-written"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::File { source, .. } => Some(source),
            _ => None,
        }
    }
}
