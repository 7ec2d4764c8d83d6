//! The manifest: all facts that are needed to reproduce a result.

use serde::Serialize;

use crate::{output::SCHEMA_VERSION, scene::NamedScene};

#[derive(Clone, Debug, Serialize)]
pub struct Manifest {
    schema_version: u32,
    pub version: &'static str,
    /// Commit of the build, or `unknown`.
    pub git_commit: &'static str,
    /// Whether tracked files differed from this commit. It is `null` if this is unknown.
    pub git_dirty: Option<bool>,
    pub toolchain: &'static str,
    pub target: &'static str,
    /// The arguments of the command, if they affect the result.
    pub command: String,
    /// Name of the scene. `None` if the result has no named scene.
    pub scene: Option<String>,
    /// Text of the scene file, unchanged.
    pub scene_text: Option<String>,
    /// Text of the file that the scene's key `felt_curve` names.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt_curve_text: Option<String>,
}

impl Manifest {
    pub fn new(command: String, scene: &NamedScene) -> Self {
        Self {
            scene: Some(scene.name.clone()),
            scene_text: Some(scene.text.clone()),
            felt_curve_text: scene.scene.wall_hit.felt.text().map(str::to_owned),
            ..Self::without_scene(command)
        }
    }

    /// The manifest for the arguments of this process.
    pub fn of_call(scene: Option<&NamedScene>) -> Self {
        let words = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned());
        let command = words.collect::<Vec<_>>().join(" ");
        match scene {
            Some(scene) => Self::new(command, scene),
            None => Self::without_scene(command),
        }
    }

    fn without_scene(command: String) -> Self {
        Self {
            schema_version: SCHEMA_VERSION,
            version: env!("CARGO_PKG_VERSION"),
            git_commit: env!("ZWIDTH_COMMIT"),
            git_dirty: env!("ZWIDTH_DIRTY").parse().ok(),
            toolchain: env!("ZWIDTH_TOOLCHAIN"),
            target: env!("ZWIDTH_TARGET"),
            command,
            scene: None,
            scene_text: None,
            felt_curve_text: None,
        }
    }

    /// The facts as pairs of name and value, for people.
    pub fn facts(&self) -> Vec<(String, String)> {
        [
            ("command", self.command.as_str()),
            ("version", self.version),
            ("commit", self.git_commit),
            ("uncommitted changes", env!("ZWIDTH_DIRTY")),
            ("toolchain", self.toolchain),
            ("target", self.target),
        ]
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .to_vec()
    }
}
