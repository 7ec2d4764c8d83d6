//! `[designs.NAME]`: named velocity filters. A user selects one on the board, or in a command with `SCENE:NAME`.

use zwidth::{
    device::designs::{DESIGNS_MAX, NamedFilter, is_design_name},
    store::Name,
};

use super::{
    NamedScene, Scene,
    velocity::{CUTOFF, VelocityTable, key_of},
};
use crate::{error::Error, range::refused};

impl VelocityTable {
    fn check_design(&self, key: &str, scene: &Scene) -> Result<(), String> {
        let filter = self.settings().ok_or_else(|| format!("{key}.{CUTOFF} is missing"))?;
        let built = scene.settings(filter, 0.0, 0.0).build(&scene.design()).map(|_| ());
        self.check().and(built).map_err(|error| {
            let own = key_of(error.parameter).unwrap_or(error.parameter);
            refused(&format!("{key}.{own}"), error.value, &error.range)
        })
    }
}

impl Scene {
    /// Checks `[designs]`, and that `board.design` names one of the designs.
    pub(super) fn check_designs(&self) -> Result<(), String> {
        let count = self.designs.len();
        if count > DESIGNS_MAX {
            return Err(format!("designs has {count} tables, allowed 0 to {DESIGNS_MAX}"));
        }
        for (n, (name, design)) in self.designs.iter().enumerate() {
            let key = format!("designs.{name}");
            if !is_design_name(name) || name == "none" {
                let most = Name::LEN;
                return Err(format!(
                    "{key}: a design's name has 1 to {most} of a to z, 0 to 9 and -, and is not none"
                ));
            }
            design.check_design(&key, self)?;
            let same = |other: &VelocityTable| other.settings() == design.settings();
            if let Some((other, _)) = self.designs.iter().take(n).find(|(_, other)| same(other)) {
                return Err(format!("{key} is the same filter as designs.{other}"));
            }
        }
        match self.board.as_ref().and_then(|board| board.design.as_deref()) {
            Some(name) if !self.designs.contains_key(name) => {
                Err(format!("board.design is `{name}`, {}", self.known_designs()))
            }
            _ => Ok(()),
        }
    }

    fn known_designs(&self) -> String {
        match self.designs.is_empty() {
            true => "but the scene has no [designs.NAME]".into(),
            false => {
                format!("allowed {}", self.designs.keys().cloned().collect::<Vec<_>>().join(", "))
            }
        }
    }

    /// The designs as a device record stores them, sorted by name.
    pub fn named_filters(&self) -> Vec<NamedFilter> {
        let named = |(name, design): (&String, &VelocityTable)| {
            Some(NamedFilter { name: Name::new(name)?, velocity: design.settings()? })
        };
        self.designs.iter().filter_map(named).collect()
    }

    /// The scene with this design as its filter. The new scene's sweep has only the design's cutoff, because the design
    /// may not allow other cutoffs.
    pub fn with_design(&self, name: &str) -> Result<Self, String> {
        let known = || format!("there is no design `{name}`, {}", self.known_designs());
        let mut scene = self.clone();
        scene.velocity = *self.designs.get(name).ok_or_else(known)?;
        if let Some(cutoff_hz) = scene.velocity.cutoff_hz() {
            scene.sweep.cutoffs_hz = vec![cutoff_hz];
        }
        Ok(scene)
    }
}

impl NamedScene {
    /// The scene with this design as its filter. The scene's text is changed too.
    pub(super) fn with_design(self, name: &str) -> Result<Self, Error> {
        let scene = self.scene.with_design(name);
        let scene = scene.map_err(|error| Error::Input(format!("{}: {error}", self.name)))?;
        let text = toml::to_string(&scene)
            .map_err(|error| Error::Internal(format!("{}: {error}", self.name)))?;
        Ok(Self { name: format!("{}-{name}", self.name), text, scene, ..self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DESIGNS: &str = "\n[designs.quiet]\nestimator = \"butterworth\"\ncutoff_hz = 500\n\n\
        [designs.stiff]\nestimator = \"biquad\"\ncutoff_hz = 555\ndamping = 0.561\nlead_s = 0.0002099\n\
        zero = -0.6651\n\n[designs.plain]\nestimator = \"difference\"\n";

    fn with(more: &str) -> Result<NamedScene, String> {
        let paper = NamedScene::load("paper-1um").unwrap().text;
        NamedScene::parse("my".into(), format!("{paper}{more}"), "my.toml")
            .map_err(|e| e.to_string())
    }

    #[test]
    fn designs_are_read_written_and_taken() {
        let named = with(DESIGNS).unwrap();
        let again: Scene = toml::from_str(&toml::to_string(&named.scene).unwrap()).unwrap();
        assert_eq!(again, named.scene);
        let filters = named.scene.named_filters();
        let names: Vec<&str> = filters.iter().map(|filter| filter.name.text()).collect();
        assert_eq!(names, ["plain", "quiet", "stiff"]);
        for filter in filters {
            let one = named.clone().with_design(filter.name.text()).unwrap();
            assert_eq!(one.name, format!("my-{}", filter.name.text()));
            assert_eq!(one.scene.velocity.settings(), Some(filter.velocity));
            assert_eq!(one.scene.designs, named.scene.designs);
            // The changed text gives the same scene.
            assert_eq!(NamedScene::parse(one.name, one.text, "").unwrap().scene, one.scene);
        }
        let error = named.with_design("loud").unwrap_err().to_string();
        assert_eq!(error, "my: there is no design `loud`, allowed plain, quiet, stiff");
    }

    #[test]
    fn what_is_wrong_with_a_design_is_named() {
        let low = "estimator = \"butterworth\"\n";
        for (more, text) in [
            (format!("[designs.a]\n{low}"), "designs.a.cutoff_hz is missing"),
            (format!("[designs.a]\n{low}cutoff_hz = 9000\n"), "designs.a.cutoff_hz is 9000, allowed "),
            (
                "[designs.a]\nestimator = \"difference\"\ncutoff_hz = 5\n".into(),
                "cutoff_hz is 5, the estimator difference has none",
            ),
            (
                "[designs.a]\nestimator = \"biquad\"\ncutoff_hz = 500\ndamping = 90\nlead_s = 0\nzero = 0\n".into(),
                "designs.a.damping is 90, allowed ",
            ),
            (format!("[designs.Loud]\n{low}cutoff_hz = 500\n"), "designs.Loud: a design's name has"),
            (format!("[designs.none]\n{low}cutoff_hz = 500\n"), "designs.none: a design's name has"),
            (
                format!("[designs.a]\n{low}cutoff_hz = 500\n[designs.b]\n{low}cutoff_hz = 500.0\n"),
                "designs.b is the same filter as designs.a",
            ),
            (format!("[designs.a]\n{low}cutoff_hz = 500\nzero = 1\n"), "unknown field `zero`"),
            (
                format!("{DESIGNS}[board]\nname = \"b\"\ndesign = \"c\"\n"),
                "board.design is `c`, allowed plain, quiet, stiff",
            ),
            ("[board]\nname = \"b\"\ndesign = \"c\"\n".into(), "board.design is `c`, but the scene has no [designs"),
        ] {
            let error = with(&format!("\n{more}")).unwrap_err();
            assert!(error.contains(text), "{more}: {error}");
        }
        let many: String =
            (0..17).map(|n| format!("[designs.d{n}]\n{low}cutoff_hz = {}\n", 500 + n)).collect();
        assert!(
            with(&format!("\n{many}"))
                .unwrap_err()
                .contains("designs has 17 tables, allowed 0 to 16")
        );
    }
}
