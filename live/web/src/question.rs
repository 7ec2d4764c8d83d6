//! A worker's question is JSON and the question's data. The answer is JSON, then blocks of bytes.

use host_sim::{
    error::{Error, one_line},
    scene::{BUILT_IN, NamedScene},
};
use serde::Deserialize;
use serde_json::{Value, json};
use virtual_board::board::{Board, NUCLEO_F446RE};

use crate::{board, study};

/// All keys that a question may have.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Question {
    ask: String,
    /// Name of a built-in scene. If there is a `text`, it is the name of the text's file.
    scene: String,
    /// Text of a scene file.
    text: Option<String>,
    board: Option<String>,
    /// Whether the board is the core without a chip.
    pub core: bool,
    pub message: String,
    pub ms: u32,
    /// Simulated seconds per second of real time.
    pub speed: f64,
    pub from: u64,
    pub rows: u64,
    pub estimator: String,
    pub cutoff_hz: Option<f64>,
    /// K and B in the scene's units.
    pub k: f64,
    pub b: f64,
    pub repeat: Option<u32>,
    pub cutoffs_hz: Option<Vec<f64>>,
    pub stiffnesses: Vec<f64>,
    pub dampings: Vec<f64>,
    pub budget: Option<u32>,
    pub walked: Vec<study::Walked>,
}

pub type Answered = Result<(Value, Vec<Vec<u8>>), Error>;

impl Question {
    /// Loads the scene that the question names or contains.
    ///
    /// # Errors
    /// No scene has this name, or the question's text is not a valid scene. The error names file, key, value and the
    /// allowed values.
    pub fn scene(&self) -> Result<NamedScene, Error> {
        match &self.text {
            None => {
                let built_in = self.scene.split(':').next().unwrap_or_default();
                if BUILT_IN.iter().all(|(name, _)| *name != built_in) {
                    let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
                    let (scene, names) = (one_line(&self.scene), names.join(", "));
                    return Err(Error::Input(format!(
                        "scene is {scene}, allowed {names}, or a file that is dropped here"
                    )));
                }
                NamedScene::load(&self.scene)
            }
            Some(text) => {
                let name = self.scene.strip_suffix(".toml").unwrap_or(&self.scene);
                let mut scene = NamedScene::parse(name.to_owned(), text.clone(), &self.scene)?;
                // A scene with a text is never a built-in scene, even with the name of a built-in scene. A loaded file
                // is treated in the same way.
                scene.files.insert(0, self.scene.clone().into());
                Ok(scene)
            }
        }
    }

    /// The board that the question names.
    pub fn board(&self) -> Result<Board, Error> {
        Board::asked(self.board.as_deref().unwrap_or(NUCLEO_F446RE.name))
    }
}

/// Answers a question. `given` is the question's JSON, followed by its data. If the input is wrong, the answer is
/// `error` with one line.
pub fn answer(given: Vec<Vec<u8>>) -> Vec<Vec<u8>> {
    let (value, mut bytes) =
        asked(given).unwrap_or_else(|error| (json!({ "error": error.to_string() }), vec![]));
    bytes.insert(0, value.to_string().into_bytes());
    bytes
}

fn asked(given: Vec<Vec<u8>>) -> Answered {
    let mut given = given.into_iter();
    let text = given.next().unwrap_or_default();
    let question: Question = serde_json::from_slice(&text)
        .map_err(|error| Error::Input(format!("the question: {error}")))?;
    let bytes = given.next().unwrap_or_default();
    match question.ask.as_str() {
        "scene" => study::scene(&question),
        "start" => board::start(&question, bytes),
        "run" => board::run(&question),
        "say" => board::say(&question),
        "tick" => board::tick(),
        "rows" => board::rows(&question),
        "board hit" => board::hit(&question, bytes),
        "predict" => study::predicted(&question),
        "hit" => study::hit(&question),
        "cutoffs" => study::cutoffs(&question),
        "walk" => study::walk(&question),
        "sweep" => study::sweep(&question),
        "grid" => study::grid(&question),
        "design" => study::design(&question),
        other => Err(Error::Input(format!("nobody can be asked `{other}`"))),
    }
}
