//! A scene's device in the loops of the boards.

use crate::{
    error::Error,
    scene::{NamedScene, Scene},
};

/// For each board, its name and the scene with the board's latency and output stage.
///
/// # Errors
/// The scene is not allowed with a board's latency or output.
pub fn boards(scene: &Scene) -> Result<Vec<(String, Scene)>, Error> {
    let mut boards = vec![];
    for name in ["nucleo-f446re", "discovery-f407"] {
        let board = NamedScene::load(name)?;
        let mut own = scene.clone();
        let rates = own.control.rate_hz / board.scene.control.rate_hz;
        own.actuator.latency = board.scene.actuator.latency * rates;
        own.output = board.scene.output;
        own.check().map_err(Error::Input)?;
        boards.push((board.name, own));
    }
    Ok(boards)
}
