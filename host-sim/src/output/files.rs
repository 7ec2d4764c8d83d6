//! Writes all results. Either all files of a command appear, or none. Each file is first written to a draft beside its
//! final path, and flushed. Then all drafts are renamed.
//!
//! First, all links in a path are resolved. The resolved path must not be an input or another result. No other program
//! may write to it at the same time.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

pub use super::draft::abandon;
use super::draft::{self, Draft, Undo, is_same};
use crate::{
    error::Error,
    output::{
        figure::Figure,
        in_units,
        manifest::Manifest,
        table::{self, About, Format, Kind},
    },
    scene::{NamedScene, Units},
};

const CSV: &str = ".csv";
const PARQUET: &str = ".parquet";

/// Name of the file that is written last. If this file exists, the result is complete.
pub const MANIFEST: &str = "manifest.json";

#[derive(Debug)]
pub struct Outputs {
    force: bool,
    inputs: Vec<PathBuf>,
    files: Vec<Output>,
    folders: Vec<Folder>,
    /// Folders that were already searched for drafts of killed programs.
    cleaned: Vec<PathBuf>,
    /// Folders that this command has made. The outermost folder is first.
    created: Vec<PathBuf>,
    /// Whether the tables in a folder are also written as Parquet.
    parquet: bool,
}

/// One of the files of [`Outputs`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place(usize);

/// One of the result folders of [`Outputs`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FolderPlace(usize);

#[derive(Debug)]
struct Output {
    /// The path as the user gave it.
    shown: PathBuf,
    /// Final path of the file.
    place: PathBuf,
    draft: io::BufWriter<Draft>,
    is_written: bool,
    /// The CSV text of a table, and the format to which the complete text is converted.
    table: Option<(Format, About, String)>,
}

#[derive(Debug)]
struct Folder {
    shown: PathBuf,
    units: Units,
    /// Names of all files that this result may have.
    possible: Vec<String>,
    manifest: Place,
    /// Text of the manifest. The tables in `tables` also contain this text.
    told: String,
    tables: Vec<Place>,
}

impl Outputs {
    /// Starts without files. Existing files are replaced only if `force` is true. The command's `inputs` are never
    /// replaced.
    pub fn new(force: bool, inputs: &[PathBuf]) -> Self {
        let (files, folders, cleaned, created) = (vec![], vec![], vec![], vec![]);
        let (inputs, parquet) = (inputs.to_vec(), false);
        Self { force, inputs, files, folders, cleaned, created, parquet }
    }

    /// Also writes each table of a result folder as Parquet.
    ///
    /// # Errors
    /// [`Error::Input`] if this build cannot write Parquet.
    pub fn with_parquet(mut self) -> Result<Self, Error> {
        Format::Parquet.is_there("--parquet")?;
        self.parquet = true;
        Ok(self)
    }

    /// Reserves a file. The file appears after [`commit`](Self::commit).
    ///
    /// # Errors
    /// [`Error::Input`] if the file cannot be written, already exists, is an input or another output, or is being
    /// written by another program.
    pub fn file(&mut self, path: &Path) -> Result<Place, Error> {
        let (place, draft) = self.reserve(path)?;
        self.refuse(path, &place, None)?;
        Ok(self.push(path, place, draft))
    }

    fn push(&mut self, path: &Path, place: PathBuf, draft: Draft) -> Place {
        let draft = io::BufWriter::new(draft);
        self.files.push(Output {
            shown: path.into(),
            place,
            draft,
            is_written: false,
            table: None,
        });
        Place(self.files.len() - 1)
    }

    /// Reserves the file of an option, if this option is given.
    pub fn option(&mut self, path: Option<&PathBuf>) -> Result<Option<Place>, Error> {
        path.map(|path| self.file(path)).transpose()
    }

    /// Reserves the file of a table, if its option is given. Commands write CSV to the file. The ending of the file's
    /// name selects the format.
    ///
    /// # Errors
    /// The errors of [`file`](Self::file) and of [`Format::of`].
    pub fn table(
        &mut self,
        path: Option<&PathBuf>,
        kind: Kind,
        scene: Option<&NamedScene>,
    ) -> Result<Option<Place>, Error> {
        let Some(path) = path else { return Ok(None) };
        let format = Format::of(path, kind)?;
        let place = self.file(path)?;
        if format != Format::Csv {
            let manifest = json(&Manifest::of_call(scene))?;
            self.files[place.0].table = Some((format, About { kind, manifest }, String::new()));
        }
        Ok(Some(place))
    }

    /// Reserves the file of a figure, if its option is given.
    ///
    /// # Errors
    /// The errors of [`file`](Self::file), and [`Error::Input`] for an ending other than `.svg` and `.png`.
    pub fn figure(&mut self, path: Option<&PathBuf>) -> Result<Option<Place>, Error> {
        path.map_or(Ok(()), |path| is_svg(path).map(|_| ()))?;
        self.option(path)
    }

    /// Reserves a folder for a result. The folder can have the manifest and any of the files `possible`. A name without
    /// an ending is a figure. Tables are converted to the given units.
    ///
    /// # Errors
    /// The errors of [`file`](Self::file), and [`Error::Input`] if one of these files exists and `force` is not set.
    pub fn folder(
        &mut self,
        folder: &Path,
        units: Units,
        possible: &[&str],
    ) -> Result<FolderPlace, Error> {
        let path = folder.join(MANIFEST);
        let (place, draft) = self.reserve(&path)?;
        let files = |name: &&str| match name.contains('.') {
            true => vec![(*name).to_owned()],
            false => [".svg", ".png"].map(|ending| format!("{name}{ending}")).to_vec(),
        };
        let as_parquet = |name: &&str| name.strip_suffix(CSV).map(|stem| stem.to_owned() + PARQUET);
        let also = possible.iter().filter_map(as_parquet);
        let possible = possible.iter().chain([&MANIFEST]).flat_map(files).chain(also);
        let possible: Vec<String> = possible.collect();
        for name in &possible {
            let path = folder.join(name);
            self.refuse(&path, &real(&path)?, Some((folder, name)))?;
        }
        let manifest = self.push(&path, place, draft);
        self.folders.push(Folder {
            shown: folder.into(),
            units,
            possible,
            manifest,
            told: String::new(),
            tables: vec![],
        });
        Ok(FolderPlace(self.folders.len() - 1))
    }

    /// Writes the next bytes of a file.
    ///
    /// # Errors
    /// [`Error::File`], for example on a full disk.
    pub fn write(&mut self, Place(index): Place, bytes: &[u8]) -> Result<(), Error> {
        let output = &mut self.files[index];
        output.is_written = true;
        match &mut output.table {
            Some((.., text)) => {
                text.push_str(&String::from_utf8_lossy(bytes));
                Ok(())
            }
            None => output.draft.write_all(bytes).map_err(Error::file(&output.shown)),
        }
    }

    /// Writes a table in these units to the file of an option, if this option is given.
    pub fn tell(
        &mut self,
        place: Option<Place>,
        units: Units,
        csv: impl FnOnce() -> String,
    ) -> Result<(), Error> {
        let Some(place) = place else { return Ok(()) };
        self.write(place, in_units::csv(units, csv()).as_bytes())
    }

    /// Draws a figure into the file of an option, if this option is given. The file's name selects the format.
    pub fn draw<E: Into<Error>>(
        &mut self,
        place: Option<Place>,
        figure: impl FnOnce() -> Result<Figure, E>,
    ) -> Result<(), Error> {
        let Some(place) = place else { return Ok(()) };
        let figure = figure().map_err(Into::into)?;
        let bytes = match is_svg(&self.files[place.0].shown)? {
            true => figure.svg().as_bytes().to_vec(),
            false => figure.png()?,
        };
        self.write(place, &bytes)
    }

    /// Adds a complete text to a result folder. Tables are converted to the units of the folder's scene.
    pub fn add(&mut self, to: FolderPlace, name: &str, text: String) -> Result<(), Error> {
        let units = self.folders[to.0].units;
        let text = if name.ends_with(CSV) { in_units::csv(units, text) } else { text };
        self.put(to, name, text.as_bytes())
    }

    fn put(&mut self, to: FolderPlace, name: &str, bytes: &[u8]) -> Result<(), Error> {
        let folder = &self.folders[to.0];
        let place = match name {
            MANIFEST => folder.manifest,
            _ => {
                let path = folder.shown.join(name);
                self.file(&path)?
            }
        };
        self.write(place, bytes)?;
        match name.strip_suffix(CSV) {
            Some(stem) if self.parquet => {
                let path = self.folders[to.0].shown.join(stem.to_owned() + PARQUET);
                let beside = self.file(&path)?;
                let about = About { kind: Kind::Rows, manifest: String::new() };
                self.files[beside.0].table = Some((Format::Parquet, about, String::new()));
                self.folders[to.0].tables.push(beside);
                self.write(beside, bytes)
            }
            None if name == MANIFEST => {
                self.folders[to.0].told = String::from_utf8_lossy(bytes).into_owned();
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Adds a figure to a result folder, as `STEM.svg` and `STEM.png`.
    pub fn add_figure(
        &mut self,
        to: FolderPlace,
        stem: &str,
        figure: &Figure,
    ) -> Result<(), Error> {
        self.put(to, &format!("{stem}.svg"), figure.svg().as_bytes())?;
        self.put(to, &format!("{stem}.png"), &figure.png()?)
    }

    /// Makes a draft for `path`. Returns the resolved path and the draft.
    fn reserve(&mut self, path: &Path) -> Result<(PathBuf, Draft), Error> {
        let folder = folder_of(path);
        let unwritable = |error: io::Error| {
            Error::Input(format!("{}: cannot write there: {error}", folder.display()))
        };
        if path.file_name().is_none() || path.as_os_str().as_encoded_bytes().ends_with(b"/") {
            return Err(Error::Input(format!("{} is no name of a file", path.display())));
        }
        self.created.extend(draft::make_folder(folder).map_err(unwritable)?);
        let place = real(path)?;
        if let Some(other) = self.files.iter().find(|output| output.place == place) {
            return Err(self.same(path, &other.shown));
        }
        let folder = folder_of(&place).to_path_buf();
        if !self.cleaned.contains(&folder) {
            draft::remove_left_overs(&folder);
            self.cleaned.push(folder);
        }
        match Draft::new(&place).map_err(unwritable)? {
            Some(draft) => Ok((place, draft)),
            None => Err(Error::Input(format!(
                "{} is being written by another run; wait for its end, or write elsewhere",
                path.display()
            ))),
        }
    }

    fn same(&self, path: &Path, other: &Path) -> Error {
        let (path, other) = (path.display(), other.display());
        Error::Input(format!("{path} and {other} are the same file, and would be written twice"))
    }

    /// Checks that a path may be written. If the file is in a result folder, `of` has this folder and the file's name.
    fn refuse(&self, path: &Path, place: &Path, of: Option<(&Path, &str)>) -> Result<(), Error> {
        let shown = path.display();
        let Ok(found) = fs::symlink_metadata(place) else {
            return Ok(()); // no file has this path; other errors appear when it is written
        };
        for input in &self.inputs {
            let same = fs::canonicalize(input).is_ok_and(|input| input == place)
                || fs::metadata(input).is_ok_and(|input| is_same(&input, &found));
            if same {
                let input = input.display();
                let what = format!("{shown} is the input {input}; it is not replaced");
                return Err(Error::Input(what));
            }
        }
        for other in self.files.iter().filter(|other| other.place != place) {
            if fs::symlink_metadata(&other.place).is_ok_and(|other| is_same(&other, &found)) {
                return Err(self.same(path, &other.shown));
            }
        }
        match of {
            _ if !found.is_file() => Err(Error::Input(format!(
                "{shown} is there already and is no plain file; it is not replaced"
            ))),
            _ if self.force => Ok(()),
            None => Err(Error::Input(format!("{shown} is there already; --force replaces it"))),
            Some((folder, name)) => Err(Error::Input(format!(
                "{} holds a result already ({name}); --force replaces it, --out writes elsewhere",
                folder.display()
            ))),
        }
    }

    /// Moves all written files to their paths, or none. In a result folder, the older manifest is removed first,
    /// together with older files that are not in the new result. The new manifest is moved last. So a folder with a
    /// manifest always has one complete result.
    ///
    /// # Errors
    /// [`Error::File`] on a full disk, or if a folder was changed by another program. [`Error::Input`] in the cases of
    /// [`file`](Self::file). After an error all files are as before.
    pub fn commit(mut self) -> Result<(), Error> {
        for folder in &self.folders {
            for table in &folder.tables {
                if let Some((_, about, _)) = &mut self.files[table.0].table {
                    about.manifest.clone_from(&folder.told);
                }
            }
        }
        for output in &mut self.files {
            if let Some((format, about, text)) = output.table.take() {
                let bytes = table::bytes(format, &text, &about)?;
                output.draft.write_all(&bytes).map_err(Error::file(&output.shown))?;
            }
            let flushed = output.draft.flush();
            let flushed = flushed.and_then(|()| output.draft.get_ref().file.sync_all());
            flushed.map_err(Error::file(&output.shown))?;
        }
        // A signal can end the process before this line or after the last file, but not in between.
        let guard = draft::traces();
        let moved = self.move_all();
        drop(guard);
        moved?;
        for folder in std::mem::take(&mut self.created) {
            draft::traces().forget(&folder);
        }
        Ok(())
    }

    fn move_all(&self) -> Result<(), Error> {
        let mut gone = vec![];
        for folder in &self.folders {
            let names = folder.possible.iter().map(String::as_str).filter(|&name| name != MANIFEST);
            gone.extend([MANIFEST].into_iter().chain(names).map(|name| folder.shown.join(name)));
        }
        let written: Vec<&Output> = self.files.iter().filter(|output| output.is_written).collect();
        let mut undo = Undo::default();
        for path in &gone {
            let place = real(path)?;
            self.refuse(path, &place, None)?;
            if fs::symlink_metadata(&place).is_ok() {
                undo.keep(&place).map_err(Error::file(path))?;
                let is_replaced = written.iter().any(|output| output.place == place);
                if !is_replaced || place.ends_with(MANIFEST) {
                    fs::remove_file(&place).map_err(Error::file(path))?;
                }
            }
        }
        let is_manifest = |output: &&&Output| output.place.ends_with(MANIFEST);
        let (last, first): (Vec<&Output>, Vec<&Output>) = written.iter().partition(is_manifest);
        for output in first.into_iter().chain(last) {
            if output.place.ends_with(MANIFEST) {
                sync_folder(folder_of(&output.place));
            }
            self.refuse(&output.shown, &output.place, None)?;
            undo.place(&output.draft.get_ref().path, &output.place)
                .map_err(Error::file(&output.shown))?;
        }
        undo.release();
        for output in &written {
            sync_folder(folder_of(&output.place));
        }
        Ok(())
    }
}

impl Drop for Outputs {
    /// Removes all drafts, and the folders made for a result.
    fn drop(&mut self) {
        self.files.clear();
        draft::remove_folders(&self.created);
    }
}

/// The path with all links and `.` in its folder resolved. A link at the end of the path is kept.
fn real(path: &Path) -> Result<PathBuf, Error> {
    let folder = folder_of(path);
    let folder = fs::canonicalize(folder).map_err(|error| {
        Error::Input(format!("{}: cannot write there: {error}", folder.display()))
    })?;
    Ok(folder.join(path.file_name().unwrap_or_default()))
}

pub(super) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Makes renames permanent, even after a power failure, if the system supports this.
pub(super) fn sync_folder(folder: &Path) {
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all(); // some file systems do not support this call
    }
}

/// Whether a figure's file is SVG. Otherwise the file is PNG.
fn is_svg(path: &Path) -> Result<bool, Error> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => Ok(true),
        Some("png") => Ok(false),
        _ => Err(Error::Input(format!("{}: allowed endings are .svg and .png", path.display()))),
    }
}

/// A value as JSON, in the form that files have.
pub fn json(value: &impl serde::Serialize) -> Result<String, Error> {
    let text = serde_json::to_string_pretty(value);
    text.map(|text| text + "\n")
        .map_err(|error| Error::Internal(format!("cannot write JSON: {error}")))
}

#[cfg(test)]
mod tests;
