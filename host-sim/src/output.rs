//! Files that are whole or not there: each is written beside its place, flushed to the disk and
//! then renamed into it.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use tempfile::{NamedTempFile, TempDir};

use crate::{error::Error, figure::Figure};

/// Name of the file that is written last: where it is, the result is complete.
pub const MANIFEST: &str = "manifest.json";

/// Refuses to replace `path` without `force`.
///
/// # Errors
/// [`Error::Input`] if it exists.
pub fn refuse_existing(path: &Path, force: bool) -> Result<(), Error> {
    if !force && path.exists() {
        return Err(Error::Input(format!(
            "{} is there already; --force replaces it",
            path.display()
        )));
    }
    Ok(())
}

/// Writes one file, whole or not at all.
///
/// # Errors
/// [`Error::Input`] if its folder cannot be written or it exists and `force` is not given,
/// [`Error::File`] if writing fails half-way.
pub fn write_file(path: &Path, bytes: &[u8], force: bool) -> Result<(), Error> {
    refuse_existing(path, force)?;
    let folder = match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error))?;
    let mut file = NamedTempFile::new_in(folder).map_err(|error| unwritable(folder, &error))?;
    file.write_all(bytes).and_then(|()| file.as_file().sync_all()).map_err(Error::file(path))?;
    open_to_all(file.path());
    file.persist(path).map_err(|error| Error::File { path: path.into(), source: error.error })?;
    Ok(())
}

/// A figure in the format that `path` asks for.
///
/// # Errors
/// [`Error::Input`] if it ends neither in `.svg` nor in `.png`.
pub fn figure_bytes(path: &Path, figure: &Figure) -> Result<Vec<u8>, Error> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => Ok(figure.svg().as_bytes().to_vec()),
        Some("png") => png(figure),
        _ => Err(Error::Input(format!("{}: allowed endings are .svg and .png", path.display()))),
    }
}

/// A figure as PNG.
///
/// # Errors
/// It cannot be drawn.
pub fn png(figure: &Figure) -> Result<Vec<u8>, Error> {
    figure.png().map_err(|error| Error::Internal(format!("cannot draw: {error}")))
}

/// A result folder in the making: its files appear together, the manifest last.
#[derive(Debug)]
pub struct Staging {
    folder: PathBuf,
    /// The folders that did not exist before, innermost first.
    created: Vec<PathBuf>,
    /// `None` once committed.
    files: Option<TempDir>,
    names: Vec<&'static str>,
}

impl Staging {
    /// Prepares `folder`; nothing in it changes before [`commit`](Self::commit).
    ///
    /// # Errors
    /// [`Error::Input`] if it cannot be written, or holds one of the files `names` and `force` is
    /// not given.
    pub fn new(folder: &Path, names: &[&str], force: bool) -> Result<Self, Error> {
        if let Some(name) = names.iter().find(|name| !force && folder.join(name).exists()) {
            return Err(Error::Input(format!(
                "{} holds a result already ({name}); --force replaces it, --out writes elsewhere",
                folder.display()
            )));
        }
        let is_new = |path: &&Path| *path != Path::new("") && !path.exists();
        let created = folder.ancestors().take_while(is_new).map(Path::to_path_buf).collect();
        let mut staging = Self { folder: folder.into(), created, files: None, names: vec![] };
        fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error))?;
        let files = tempfile::Builder::new().prefix(".partial-").tempdir_in(folder);
        staging.files = Some(files.map_err(|error| unwritable(folder, &error))?);
        Ok(staging)
    }

    /// Writes one file of the result.
    ///
    /// # Errors
    /// [`Error::File`], on a full disk for example; the folder is then left as it was.
    pub fn write(&mut self, name: &'static str, bytes: &[u8]) -> Result<(), Error> {
        let Some(files) = &self.files else {
            return Err(Error::Internal("the result is committed already".into()));
        };
        let path = files.path().join(name);
        let written = fs::File::create(&path)
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()));
        written.map_err(Error::file(self.folder.join(name)))?;
        self.names.push(name);
        Ok(())
    }

    /// Moves all files into their place. An older manifest goes first and the new one comes last,
    /// so that a folder with a manifest is complete at any time.
    ///
    /// # Errors
    /// [`Error::File`] if the folder changed under our hands.
    pub fn commit(mut self) -> Result<(), Error> {
        let Some(files) = self.files.take() else {
            return Ok(());
        };
        let manifest = self.folder.join(MANIFEST);
        match fs::remove_file(&manifest) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(Error::File { path: manifest, source: error });
            }
            _ => {}
        }
        self.names.sort_by_key(|name| *name == MANIFEST);
        for name in &self.names {
            let place = self.folder.join(name);
            fs::rename(files.path().join(name), &place).map_err(Error::file(place))?;
        }
        self.created.clear();
        Ok(())
    }
}

impl Drop for Staging {
    /// Leaves no folder behind that this result would have filled.
    fn drop(&mut self) {
        self.files = None;
        for folder in &self.created {
            let _ = fs::remove_dir(folder); // refuses a folder that holds anything
        }
    }
}

fn unwritable(folder: &Path, error: &io::Error) -> Error {
    Error::Input(format!("{}: cannot write there: {error}", folder.display()))
}

/// Temporary files are private; results are as readable as any file.
#[cfg(unix)]
fn open_to_all(path: &Path) {
    use std::os::unix::fs::PermissionsExt as _;
    let _ = fs::set_permissions(path, fs::Permissions::from_mode(0o644));
}

#[cfg(not(unix))]
fn open_to_all(_: &Path) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_that_is_not_committed_leaves_no_trace() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("a/b");
        let mut staging = Staging::new(&folder, &["x.csv", MANIFEST], false).unwrap();
        staging.write("x.csv", b"1").unwrap();
        drop(staging);
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 0);
    }

    #[test]
    fn results_are_replaced_only_with_force_and_other_files_stay() {
        let root = tempfile::tempdir().unwrap();
        let names = ["x.csv", MANIFEST];
        let write = |text: &[u8], force| {
            let mut staging = Staging::new(root.path(), &names, force)?;
            staging.write(MANIFEST, text)?;
            staging.write("x.csv", text)?;
            staging.commit()
        };
        fs::write(root.path().join("mine.txt"), "mine").unwrap();
        write(b"1", false).unwrap();
        let refused = write(b"2", false).unwrap_err();
        assert_eq!(refused.exit_code(), 2);
        assert_eq!(fs::read(root.path().join("x.csv")).unwrap(), b"1");
        write(b"3", true).unwrap();
        assert_eq!(fs::read(root.path().join(MANIFEST)).unwrap(), b"3");
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_file_is_written_whole_and_not_replaced_unasked() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("new/trace.csv");
        write_file(&path, b"1", false).unwrap();
        assert!(write_file(&path, b"2", false).is_err());
        write_file(&path, b"2", true).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"2");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn a_folder_that_cannot_be_one_is_bad_input() {
        let root = tempfile::tempdir().unwrap();
        let file = root.path().join("file");
        fs::write(&file, "").unwrap();
        assert_eq!(Staging::new(&file.join("x"), &[], true).unwrap_err().exit_code(), 2);
        assert_eq!(write_file(&file.join("x"), b"", true).unwrap_err().exit_code(), 2);
    }
}
