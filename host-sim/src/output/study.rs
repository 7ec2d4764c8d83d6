//! The folder of a study contains a description (`study.json`), one part for each unit, and a manifest that lists the
//! complete parts (`manifest.jsonl`).
//!
//! A part is written completely (draft, flush, rename). Then a line is appended to the manifest, and the manifest is
//! flushed. So a run may be killed at any time. A part without a line in the manifest is made again, with the same
//! bytes. An incomplete line is removed.

use std::{
    collections::BTreeMap,
    fs::{self, File, OpenOptions, TryLockError},
    io::{Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use super::{
    draft,
    files::{self, Outputs, folder_of, sync_folder},
};
use crate::{
    error::Error,
    simulation::prepared::Numeric,
    study::planned::{
        SCHEMA, SOURCES, Study,
        unit::{Made, sha256},
    },
};

const HEAD: &str = "study.json";
/// File with the list of complete parts.
const MANIFEST: &str = "manifest.jsonl";

/// Description of a study. With `--resume`, `key` and its contents must be the same as before.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    schema_version: u32,
    version: String,
    /// SHA-256 of the sources of core and simulator.
    sources: String,
    git_commit: String,
    git_dirty: Option<bool>,
    toolchain: String,
    target: String,
    measure: String,
    numeric: String,
    points: u64,
    units: u64,
    columns: Vec<String>,
    /// One block for each pair of scene and estimator.
    blocks: Vec<HeadBlock>,
    study_text: String,
    key: String,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct HeadBlock {
    scene: String,
    estimator: String,
    first_unit: u64,
    points_per_unit: u64,
    /// The scene with its estimator, before the study changes it.
    scene_text: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    felt_curve_text: Option<String>,
}

impl Head {
    fn of(study: &Study, numeric: Numeric) -> Self {
        let columns = study.blocks.first().map(|block| study.columns(block)).unwrap_or_default();
        let blocks = study.blocks.iter().map(|block| HeadBlock {
            scene: block.name.clone(),
            estimator: block.estimator.into(),
            first_unit: block.first_unit,
            points_per_unit: block.points_per_unit,
            scene_text: block.table.to_string(),
            felt_curve_text: block.curve.clone(),
        });
        Self {
            schema_version: SCHEMA,
            version: env!("CARGO_PKG_VERSION").into(),
            sources: SOURCES.into(),
            git_commit: env!("ZWIDTH_COMMIT").into(),
            git_dirty: env!("ZWIDTH_DIRTY").parse().ok(),
            toolchain: env!("ZWIDTH_TOOLCHAIN").into(),
            target: env!("ZWIDTH_TARGET").into(),
            measure: study.file.keys.measure.name().into(),
            numeric: numeric.name().into(),
            points: study.points,
            units: study.units,
            columns: columns.into_iter().map(|column| column.name).collect(),
            blocks: blocks.collect(),
            study_text: study.file.text.clone(),
            key: study.key(numeric),
        }
    }

    /// The first difference between this study and the study `other` of a folder, as text.
    fn difference(&self, other: &Self) -> Option<String> {
        let pairs = [
            ("schema_version", self.schema_version.to_string(), other.schema_version.to_string()),
            ("version", self.version.clone(), other.version.clone()),
            ("sources", short(&self.sources), short(&other.sources)),
            ("measure", self.measure.clone(), other.measure.clone()),
            ("numeric", self.numeric.clone(), other.numeric.clone()),
        ];
        if let Some((name, ours, theirs)) =
            pairs.into_iter().find(|(_, ours, theirs)| ours != theirs)
        {
            return Some(format!("its {name} is {theirs}, here {ours}"));
        }
        let name = |block: &HeadBlock| format!("{} with {}", block.scene, block.estimator);
        let names = |head: &Self| head.blocks.iter().map(name).collect::<Vec<_>>().join(", ");
        if names(self) != names(other) {
            return Some(format!("its scenes are {}, here {}", names(other), names(self)));
        }
        let content = |block: &HeadBlock| (block.scene_text.clone(), block.felt_curve_text.clone());
        let mut pairs = self.blocks.iter().zip(&other.blocks);
        if let Some((ours, _)) = pairs.find(|(ours, theirs)| content(ours) != content(theirs)) {
            return Some(format!("its scene {} is another one than here", ours.scene));
        }
        (self.key != other.key).then(|| "its points or units are others than here".into())
    }
}

/// The first digits of a hash, for people.
fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

/// A line of the manifest. There is one for each complete part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    pub unit: u64,
    pub key: String,
    pub file: String,
    pub bytes: u64,
    pub sha256: String,
    pub rows: u64,
    /// Number of hits that were run for the part.
    pub hits: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    pub csv: String,
    pub rows: u64,
    pub hits: u64,
}

impl From<&Made> for Part {
    fn from(made: &Made) -> Self {
        let (csv, rows) = (made.table.csv(), made.table.rows.len() as u64);
        Self { csv, rows, hits: made.hits }
    }
}

/// The folder of a study. Only one run at a time can have the folder open.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    /// Units with complete parts.
    done: BTreeMap<u64, Entry>,
    manifest: File,
    /// Length of all complete lines of the manifest, in bytes.
    whole: u64,
    inputs: Vec<PathBuf>,
    is_resumed: bool,
    /// The open file keeps the lock on the study.
    _head: File,
}

impl Folder {
    /// Opens the folder at `path`. A folder that already has the study is only opened with `resume`.
    ///
    /// # Errors
    /// [`Error::Input`] in these cases: the folder has a study and `resume` is not set; the folder has another study;
    /// another run has the folder open; the folder cannot be written. [`Error::File`] on a full disk.
    pub fn open(
        path: &Path,
        study: &Study,
        numeric: Numeric,
        resume: bool,
        inputs: &[PathBuf],
    ) -> Result<Self, Error> {
        let shown = path.display();
        let head = path.join(HEAD);
        let ours = Head::of(study, numeric);
        let is_resumed = head.exists();
        if is_resumed && !resume {
            return Err(Error::Input(format!(
                "{shown} holds a study already; --resume goes on with it, --out writes elsewhere"
            )));
        }
        if is_resumed {
            let text = fs::read_to_string(&head).map_err(Error::file(&head))?;
            let theirs: Head = serde_json::from_str(&text).map_err(|error| {
                Error::Input(format!("{}: no study of this program: {error}", head.display()))
            })?;
            if let Some(difference) = ours.difference(&theirs) {
                return Err(Error::Input(format!(
                    "{shown} holds another study: {difference}; --out writes elsewhere"
                )));
            }
        } else {
            let mut outputs = Outputs::new(false, inputs);
            let (place, manifest) = (outputs.file(&head)?, outputs.file(&path.join(MANIFEST))?);
            outputs.write(place, files::json(&ours)?.as_bytes())?;
            outputs.write(manifest, b"")?;
            outputs.commit()?;
        }
        let lock = File::open(&head).map_err(Error::file(&head))?;
        match lock.try_lock() {
            Err(TryLockError::WouldBlock) => {
                let what = format!("{shown} is being written by another run; wait for its end");
                return Err(Error::Input(what));
            }
            Err(TryLockError::Error(error)) if error.kind() != std::io::ErrorKind::Unsupported => {
                return Err(Error::file(&head)(error));
            }
            _ => {}
        }
        draft::remove_left_overs(path);
        let place = path.join(MANIFEST);
        let opened =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&place);
        let mut manifest = opened.map_err(Error::file(&place))?;
        let mut text = vec![];
        manifest.read_to_end(&mut text).map_err(Error::file(&place))?;
        let whole = text.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let mut done = BTreeMap::new();
        for (n, line) in (1..).zip(text[..whole].split_inclusive(|byte| *byte == b'\n')) {
            let entry: Entry = serde_json::from_slice(line).map_err(|error| {
                Error::Input(format!("{}:{n}: no entry of a manifest: {error}", place.display()))
            })?;
            done.insert(entry.unit, entry);
        }
        done.retain(|_, entry| entry.is_whole(path));
        let whole = whole as u64;
        manifest.set_len(whole).map_err(Error::file(&place))?;
        manifest.seek(SeekFrom::Start(whole)).map_err(Error::file(&place))?;
        let (path, inputs) = (path.to_path_buf(), inputs.to_vec());
        Ok(Self { path, done, manifest, whole, inputs, is_resumed, _head: lock })
    }

    pub fn done(&self) -> &BTreeMap<u64, Entry> {
        &self.done
    }

    /// Writes the part of a unit, and adds its line to the manifest.
    ///
    /// # Errors
    /// [`Error::File`], for example on a full disk. All earlier lines stay.
    pub fn add(&mut self, unit: u64, key: String, made: &Part) -> Result<(), Error> {
        let file = format!("part-{unit:08}.csv");
        let Part { csv, rows, hits } = made;
        let (bytes, rows, hits) = (csv.as_bytes(), *rows, *hits);
        let mut outputs = Outputs::new(self.is_resumed, &self.inputs);
        let place = outputs.file(&self.path.join(&file))?;
        outputs.write(place, bytes)?;
        outputs.commit()?;
        let (sha256, bytes) = (sha256(bytes), bytes.len() as u64);
        let entry = Entry { unit, key, file, bytes, sha256, rows, hits };
        let place = self.path.join(MANIFEST);
        let line = entry.line()?;
        let appended = self.manifest.write_all(line.as_bytes());
        if let Err(error) = appended.and_then(|()| self.manifest.sync_data()) {
            let _ = self.manifest.set_len(self.whole); // if this fails, the next run removes the line
            return Err(Error::file(place)(error));
        }
        self.whole += line.len() as u64;
        sync_folder(folder_of(&place));
        self.done.insert(unit, entry);
        Ok(())
    }

    /// Sorts the manifest by units, so that its bytes do not depend on machine and order. Must be called at the end.
    ///
    /// # Errors
    /// [`Error::File`]. All lines stay.
    pub fn finish(self) -> Result<BTreeMap<u64, Entry>, Error> {
        let place = self.path.join(MANIFEST);
        let lines: Result<String, Error> = self.done.values().map(Entry::line).collect();
        let lines = lines?;
        if fs::read(&place).map_err(Error::file(&place))? != lines.as_bytes() {
            let mut outputs = Outputs::new(true, &self.inputs);
            let manifest = outputs.file(&place)?;
            outputs.write(manifest, lines.as_bytes())?;
            outputs.commit()?;
        }
        Ok(self.done)
    }
}

impl Entry {
    fn line(&self) -> Result<String, Error> {
        let line = serde_json::to_string(self);
        let line = line.map_err(|error| Error::Internal(format!("cannot write JSON: {error}")))?;
        Ok(line + "\n")
    }

    /// Whether the file of this entry exists, and has the length and hash of the entry.
    fn is_whole(&self, folder: &Path) -> bool {
        let part = folder.join(&self.file);
        let is_as_long = fs::metadata(&part).is_ok_and(|found| found.len() == self.bytes);
        is_as_long && fs::read(&part).is_ok_and(|bytes| sha256(&bytes) == self.sha256)
    }
}
