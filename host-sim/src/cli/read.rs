//! `read`: converts a device record, and settings saved on a board, into text or a scene.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::Common;
use crate::{
    error::Error,
    input,
    output::terminal::print_result,
    scene::{
        NamedScene, read_back,
        record::{load, words},
    },
};

/// Prints a device record, with the settings that a board has saved, as tables of a scene. --out writes a scene. All
/// values are in m and N at the handle, also for a rotary device.
#[derive(Debug, Args)]
pub struct ReadArgs {
    /// The device record: a file from `cargo sim prepare`, or a copy of flash sector 3, from address 0x0800C000 on.
    record: PathBuf,
    /// A copy of flash sectors 1 and 2, 32 KiB from address 0x08004000 on. The saved settings replace those of the
    /// record.
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// The scene with the values that no record has: mass, damping, stiffness, elements [default: the board's own].
    #[arg(long, value_name = "SCENE")]
    base: Option<String>,
}

/// Tables of a scene whose values are in a record.
const TABLES: [&str; 14] = [
    "encoder",
    "actuator",
    "output",
    "control",
    "velocity",
    "wall",
    "wall_hit",
    "walk",
    "board",
    "safety",
    "motor",
    "return",
    "designs",
    "passivity",
];

#[derive(Serialize)]
struct Json {
    device: String,
    board: String,
    record_hash: String,
    scene_hash: String,
    envelope_hash: String,
    /// Radius of a rotary device's handle in m. `null` for a linear device.
    radius_m: Option<f64>,
    /// Says which settings the copy of the sectors has. `null` without a copy.
    settings: Option<String>,
    boundaries: usize,
    rows: usize,
    /// The record's tables, as a scene has them.
    scene: toml::Table,
}

pub fn run(args: &ReadArgs, common: &Common) -> Result<(), Error> {
    let mut inputs = vec![args.record.clone()];
    inputs.extend(args.settings.clone());
    let words = words(&load(&args.record)?);
    let name = args.record.display();
    let recorded = read_back::device(&words).map_err(|error| error.of(&name.to_string()))?;
    let mut device = recorded;
    let mut loaded = None;
    if let Some(path) = &args.settings {
        let bytes = input::read(path, input::DEVICE)?;
        let of = |error: Error| error.of(&path.display().to_string());
        let found = read_back::saved(&recorded, bytes).map_err(of)?;
        device = read_back::with_settings(device, &found);
        loaded = Some(found.source.to_string());
    }
    let board = device.board.text();
    let base = NamedScene::load(args.base.as_deref().unwrap_or(board))?;
    inputs.extend(base.files.iter().cloned());
    let mut outputs = common.outputs(&inputs)?;
    let place = outputs.option(common.out.as_ref())?;
    let scene = base
        .scene
        .with_device(&device)
        .map_err(|why| Error::Input(format!("{}, with {name}: {why}", base.name)))?;
    let broken = |error: toml::ser::Error| Error::Internal(format!("{name}: {error}"));
    let whole = toml::Table::try_from(&scene).map_err(broken)?;
    let tables: toml::Table =
        whole.into_iter().filter(|(table, _)| TABLES.contains(&table.as_str())).collect();
    if let Some(place) = place {
        let text = format!(
            "# Read back from {name}: record {:08x}, for the device {} on the board {board}. What no record has, mass,\n\
             # damping, stiffness and elements, is that of {}. In m and N at the handle.\n{}",
            device.key.hash,
            device.key.name.text(),
            base.name,
            toml::to_string(&scene).map_err(broken)?
        );
        outputs.write(place, text.as_bytes())?;
    }
    outputs.commit()?;
    let envelope = device.envelope;
    let json = Json {
        device: device.key.name.text().into(),
        board: board.into(),
        record_hash: format!("{:08x}", device.key.hash),
        scene_hash: format!("{:08x}", device.scene_hash),
        envelope_hash: format!("{:08x}", envelope.hash()),
        radius_m: (device.radius_m > 0.0).then_some(device.radius_m),
        settings: loaded,
        boundaries: envelope.boundaries().count(),
        rows: envelope.boundaries().map(|(_, points)| points.count()).sum(),
        scene: tables,
    };
    print_result(common.json, &json, || {
        let radius = json.radius_m.map_or_else(String::new, |radius| {
            format!("# rotary, handle at {radius} m; below in m and N at the handle\n")
        });
        let settings = json
            .settings
            .as_ref()
            .map_or_else(String::new, |which| format!("# settings: {which}\n"));
        format!(
            "# {} on the board {}: record {}, scene {}, envelope {} of {} boundaries, {} rows\n{radius}{settings}{}",
            json.device,
            json.board,
            json.record_hash,
            json.scene_hash,
            json.envelope_hash,
            json.boundaries,
            json.rows,
            toml::to_string(&json.scene).unwrap_or_default().trim_end()
        )
    })
}
