//! Files that are whole or not there: each is written beside its place, flushed to the disk and
//! then renamed into it.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use tempfile::{NamedTempFile, TempDir};

use crate::{error::Error, output::figure::Figure};

/// Name of the file that is written last: where it is, the result is complete.
pub const MANIFEST: &str = "manifest.json";

/// Refuses a `path` that is no plain file, or is one already without `force`.
///
/// # Errors
/// [`Error::Input`].
pub fn refuse_existing(path: &Path, force: bool) -> Result<(), Error> {
    match fs::symlink_metadata(path) {
        Err(_) => Ok(()), // nothing there; other troubles show when it is written
        Ok(found) if !found.is_file() => Err(Error::Input(format!(
            "{} is there already and is no plain file; it is not replaced",
            path.display()
        ))),
        Ok(_) if !force => {
            Err(Error::Input(format!("{} is there already; --force replaces it", path.display())))
        }
        Ok(_) => Ok(()),
    }
}

/// Writes one file, whole or not at all.
///
/// # Errors
/// [`Error::Input`] if its folder cannot be written or [`refuse_existing`] refuses,
/// [`Error::File`] if writing fails half-way.
pub fn write_file(path: &Path, bytes: &[u8], force: bool) -> Result<(), Error> {
    let mut file = GrowingFile::new(path, force)?;
    file.write(bytes)?;
    file.finish()
}

/// A file that is written piece by piece beside its place, and is there when it is whole.
#[derive(Debug)]
pub struct GrowingFile {
    path: PathBuf,
    force: bool,
    file: io::BufWriter<NamedTempFile>,
}

impl GrowingFile {
    /// Nothing appears at `path` before [`finish`](Self::finish).
    ///
    /// # Errors
    /// [`Error::Input`] if its folder cannot be written or [`refuse_existing`] refuses.
    pub fn new(path: &Path, force: bool) -> Result<Self, Error> {
        refuse_existing(path, force)?;
        let folder = folder_of(path);
        fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error))?;
        let file = temporary_file(folder).map_err(|error| unwritable(folder, &error))?;
        Ok(Self { path: path.into(), force, file: io::BufWriter::new(file) })
    }

    /// The next piece.
    ///
    /// # Errors
    /// [`Error::File`], on a full disk for example.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.file.write_all(bytes).map_err(Error::file(&self.path))
    }

    /// Moves the file into its place.
    ///
    /// # Errors
    /// [`Error::File`] if writing or moving fails; there is then no file, or the old one.
    pub fn finish(self) -> Result<(), Error> {
        let Self { path, force, file } = self;
        let file = file.into_inner().map_err(io::IntoInnerError::into_error);
        let file = file.map_err(Error::file(&path))?;
        file.as_file().sync_all().map_err(Error::file(&path))?;
        let placed = if force { file.persist(&path) } else { file.persist_noclobber(&path) };
        placed.map_err(|error| Error::File { path: path.clone(), source: error.error })?;
        sync_folder(folder_of(&path));
        Ok(())
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// A temporary file as readable as any other that the user makes.
fn temporary_file(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(fs::Permissions::from_mode(0o666)); // less the umask
    }
    builder.tempfile_in(folder)
}

/// Makes renames last through a power cut, where the system can.
fn sync_folder(folder: &Path) {
    if let Ok(folder) = fs::File::open(folder) {
        let _ = folder.sync_all(); // not every file system takes it
    }
}

/// Refuses a `path` that ends neither in `.svg` nor in `.png`.
///
/// # Errors
/// [`Error::Input`].
pub fn refuse_ending(path: &Path) -> Result<(), Error> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg" | "png") => Ok(()),
        _ => Err(Error::Input(format!("{}: allowed endings are .svg and .png", path.display()))),
    }
}

/// A figure in the format that `path` asks for.
///
/// # Errors
/// See [`refuse_ending`].
pub fn figure_bytes(path: &Path, figure: &Figure) -> Result<Vec<u8>, Error> {
    refuse_ending(path)?;
    if path.extension().is_some_and(|extension| extension == "svg") {
        Ok(figure.svg().as_bytes().to_vec())
    } else {
        png(figure)
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
    /// Every file that a result may have.
    possible: Vec<&'static str>,
    /// The files that this one has.
    names: Vec<&'static str>,
}

impl Staging {
    /// Prepares `folder` for a result that may have the files `possible`; nothing in it changes
    /// before [`commit`](Self::commit).
    ///
    /// # Errors
    /// [`Error::Input`] if it cannot be written, or holds one of those files and `force` is not
    /// given, or holds something of that name that is no plain file.
    pub fn new(folder: &Path, possible: &[&'static str], force: bool) -> Result<Self, Error> {
        for name in possible {
            let place = folder.join(name);
            if !force && fs::symlink_metadata(&place).is_ok() {
                return Err(Error::Input(format!(
                    "{} holds a result already ({name}); --force replaces it, --out writes elsewhere",
                    folder.display()
                )));
            }
            refuse_existing(&place, force)?;
        }
        let is_new = |path: &&Path| *path != Path::new("") && !path.exists();
        let created = folder.ancestors().take_while(is_new).map(Path::to_path_buf).collect();
        let possible = possible.to_vec();
        let mut staging =
            Self { folder: folder.into(), created, files: None, possible, names: vec![] };
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

    /// Moves all files into their place. An older manifest goes first, the files of the older result
    /// that this one does not have go with it, and the new manifest comes last: a folder with a
    /// manifest is complete and of one piece at any time.
    ///
    /// # Errors
    /// [`Error::File`] if the folder changed under our hands; [`Error::Input`] before anything
    /// is touched if a place is taken by something that is no plain file.
    pub fn commit(mut self) -> Result<(), Error> {
        for name in &self.possible {
            refuse_existing(&self.folder.join(name), true)?;
        }
        let Some(files) = self.files.take() else { return Ok(()) };
        remove(&self.folder.join(MANIFEST))?;
        sync_folder(&self.folder);
        for stale in self.possible.iter().filter(|name| !self.names.contains(name)) {
            remove(&self.folder.join(stale))?;
        }
        self.names.sort_by_key(|name| *name == MANIFEST);
        for name in &self.names {
            if *name == MANIFEST {
                sync_folder(&self.folder);
            }
            let place = self.folder.join(name);
            fs::rename(files.path().join(name), &place).map_err(Error::file(place))?;
        }
        sync_folder(&self.folder);
        self.created.clear();
        Ok(())
    }
}

/// Removes a file if it is there.
fn remove(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(Error::File { path: path.into(), source: error })
        }
        _ => Ok(()),
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
    fn a_new_result_leaves_nothing_of_the_old_one() {
        let root = tempfile::tempdir().unwrap();
        let names = ["x.csv", "y.csv", MANIFEST];
        let write = |files: &[&'static str], force| {
            let mut staging = Staging::new(root.path(), &names, force)?;
            for name in files {
                staging.write(name, b"")?;
            }
            staging.commit()
        };
        write(&names, false).unwrap();
        write(&["x.csv", MANIFEST], true).unwrap();
        assert!(!root.path().join("y.csv").exists());
    }

    #[test]
    fn what_is_no_plain_file_is_refused_before_anything_is_touched() {
        let root = tempfile::tempdir().unwrap();
        let names = ["x.csv", MANIFEST];
        fs::write(root.path().join(MANIFEST), "old").unwrap();
        let mut staging = Staging::new(root.path(), &names, true).unwrap();
        staging.write("x.csv", b"new").unwrap();
        staging.write(MANIFEST, b"new").unwrap();
        fs::create_dir(root.path().join("x.csv")).unwrap();
        assert_eq!(staging.commit().unwrap_err().exit_code(), 2);
        assert_eq!(fs::read(root.path().join(MANIFEST)).unwrap(), b"old");
        assert!(Staging::new(root.path(), &names, true).is_err());
        assert!(write_file(&root.path().join("x.csv"), b"", true).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_not_replaced() {
        let root = tempfile::tempdir().unwrap();
        let link = root.path().join("link.csv");
        std::os::unix::fs::symlink("nowhere", &link).unwrap();
        assert!(write_file(&link, b"", true).is_err());
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
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
