//! Drafts: unfinished files in the folder of their final path. A draft has its own name, and is locked by its program.
//!
//! The lock shows that a draft is in use. A second program that writes to the same path gets an error. A draft without
//! a lock was left by a killed program. The next program that writes to this folder removes the draft.

use std::{
    ffi::{OsStr, OsString},
    fs::{self, File, OpenOptions, TryLockError},
    io,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

/// The names of drafts and backups start with this text, and end with `DRAFT` or `BACKUP`. A backup stays until the
/// result is complete.
const PREFIX: &str = ".zwidth-";
const DRAFT: &str = ".draft";
const BACKUP: &str = ".backup";

/// Number of attempts to make a draft. Another program may remove the draft before this program locks it.
const ATTEMPTS: usize = 100;

/// Files and folders that would be left if this process ended now.
#[derive(Default)]
pub(super) struct Traces {
    files: Vec<PathBuf>,
    /// Folders that this process has made. The outermost folder is first.
    folders: Vec<PathBuf>,
}

static TRACES: Mutex<Traces> = Mutex::new(Traces { files: vec![], folders: vec![] });

/// Locks the traces. While the traces are locked, a signal cannot end the process.
pub(super) fn traces() -> MutexGuard<'static, Traces> {
    TRACES.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Traces {
    pub(super) fn forget(&mut self, path: &Path) {
        self.files.retain(|file| file != path);
        self.folders.retain(|folder| folder != path);
    }
}

/// Removes all drafts, and the folders made for unfinished results. After this call the process cannot write any more
/// and must end.
pub fn abandon() {
    let traces = traces();
    for file in &traces.files {
        let _ = fs::remove_file(file);
    }
    for folder in traces.folders.iter().rev() {
        let _ = fs::remove_dir(folder); // fails for a folder that is not empty
    }
    std::mem::forget(traces);
}

/// Makes a folder and its parents. Returns the new folders. The outermost folder is first.
pub(super) fn make_folder(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let is_new = |path: &&Path| *path != Path::new("") && !path.exists();
    let mut new: Vec<PathBuf> =
        folder.ancestors().take_while(is_new).map(Path::to_path_buf).collect();
    new.reverse();
    traces().folders.extend(new.iter().cloned());
    let made = fs::create_dir_all(folder);
    if made.is_err() {
        remove_folders(&new);
    }
    made.map(|()| new)
}

/// Removes those folders that are empty. The innermost folder is removed first.
pub(super) fn remove_folders(folders: &[PathBuf]) {
    for folder in folders.iter().rev() {
        let _ = fs::remove_dir(folder);
        traces().forget(folder);
    }
}

/// A path for a draft or a backup. It is in the same folder as `place`.
fn beside(place: &Path, ending: &str) -> PathBuf {
    let mut name = OsString::from(PREFIX);
    name.push(place.file_name().unwrap_or_default());
    name.push(ending);
    place.with_file_name(name)
}

fn backup_of(place: &Path) -> PathBuf {
    beside(place, BACKUP)
}

/// A draft, with its file open and locked.
#[derive(Debug)]
pub(super) struct Draft {
    pub(super) path: PathBuf,
    pub(super) file: File,
}

impl Draft {
    /// Makes a new, empty draft for the path `place`. Returns `None` if another program has a draft for this path.
    pub(super) fn new(place: &Path) -> io::Result<Option<Self>> {
        let path = beside(place, DRAFT);
        for _ in 0..ATTEMPTS {
            let mut traces = traces();
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => {
                    if is_locked_by_us(&file)? && is_at(&file, &path) {
                        traces.files.push(path.clone());
                        return Ok(Some(Self { path, file }));
                    }
                    // another program took the draft for a left-over, and removed it before this program locked it
                }
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                    drop(traces);
                    if !remove_left_over(&path)? {
                        return Ok(None);
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        let mut traces = traces();
        if is_at(&self.file, &self.path) {
            let _ = fs::remove_file(&self.path);
        }
        traces.forget(&self.path);
    }
}

impl io::Write for Draft {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Tries to lock the file. The result is always `true` on a file system without locks.
fn is_locked_by_us(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => Ok(true),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Removes a draft or a backup if its program has ended. Returns `false` if the file is still in use.
fn remove_left_over(path: &Path) -> io::Result<bool> {
    let is_plain = fs::symlink_metadata(path).is_ok_and(|found| found.is_file());
    let file = match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(true),
        other => other?,
    };
    let free = is_plain && matches!(file.try_lock(), Ok(()));
    if free && is_at(&file, path) {
        fs::remove_file(path)?;
    }
    Ok(free)
}

/// Removes files that killed programs left in a folder.
pub(super) fn remove_left_overs(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        if is_ours(&entry.file_name()) {
            let _ = remove_left_over(&entry.path()); // a remaining file causes an error later, when its path is used
        }
    }
}

fn is_ours(name: &OsStr) -> bool {
    let name = name.as_encoded_bytes();
    let ours = |ending: &str| name.ends_with(ending.as_bytes());
    name.starts_with(PREFIX.as_bytes()) && (ours(DRAFT) || ours(BACKUP))
}

/// Whether `path` is the path of `file`.
fn is_at(file: &File, path: &Path) -> bool {
    match (file.metadata(), fs::symlink_metadata(path)) {
        (Ok(file), Ok(found)) => is_same(&file, &found),
        _ => false,
    }
}

/// Whether both are metadata of the same file. The file may have several paths.
#[cfg(unix)]
pub(super) fn is_same(one: &fs::Metadata, other: &fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    (one.dev(), one.ino()) == (other.dev(), other.ino())
}

/// The metadata identify a file only on Unix. On other systems the caller compares the paths.
#[cfg(not(unix))]
pub(super) fn is_same(_: &fs::Metadata, _: &fs::Metadata) -> bool {
    false
}

/// Restores the older files if not all new files could be moved to their paths.
#[derive(Default)]
pub(super) struct Undo {
    /// Older files and their backups. The backups are locked, so that other programs do not take them for left-overs
    /// and remove them.
    kept: Vec<(PathBuf, PathBuf, File)>,
    /// New files that are already at their final paths.
    placed: Vec<PathBuf>,
}

impl Undo {
    /// Keeps an older file as a backup.
    pub(super) fn keep(&mut self, place: &Path) -> io::Result<()> {
        if self.kept.iter().any(|(kept, ..)| kept == place) {
            return Ok(());
        }
        let backup = backup_of(place);
        fs::hard_link(place, &backup).or_else(|_| fs::copy(place, &backup).map(|_| ()))?;
        let file = File::open(&backup)?;
        let _ = file.try_lock(); // not every file system has locks
        self.kept.push((place.into(), backup, file));
        Ok(())
    }

    /// Moves a draft to its final path.
    pub(super) fn place(&mut self, draft: &Path, place: &Path) -> io::Result<()> {
        let is_new = fs::symlink_metadata(place).is_err();
        if !is_new {
            self.keep(place)?;
        }
        fs::rename(draft, place)?;
        if is_new {
            self.placed.push(place.into());
        }
        Ok(())
    }

    /// Keeps the new files, and removes the backups.
    pub(super) fn release(&mut self) {
        self.placed.clear();
        for (_, backup, _) in self.kept.drain(..) {
            let _ = fs::remove_file(backup);
        }
    }
}

impl Drop for Undo {
    fn drop(&mut self) {
        for place in &self.placed {
            let _ = fs::remove_file(place);
        }
        for (place, backup, _) in &self.kept {
            let _ = fs::rename(backup, place); // no effect if both names are the same file
            let _ = fs::remove_file(backup);
        }
    }
}
