//! Checks the layers of core, simulator, virtual board and live page. No file imports from a layer above its own.
//! Imports form no circle, except between a module and its child module. Kernel and product name no crate of the
//! laboratory, except in the files that offer a command of the laboratory. `cargo run --package layers` names each
//! offence with file and line. The exit code is 1 if there is an offence.
#![allow(clippy::unwrap_used, reason = "a source file that cannot be read ends the check")]

mod source;

use std::{
    collections::{BTreeMap, BTreeSet},
    process::ExitCode,
};

use self::source::{Import, Module, Source};

const SIMULATOR_CRATES: &[&str] = &["host-sim/src", "host-sim/studies/src", "host-sim/loop/src"];

/// The simulator's layers, highest first. Modules of one layer may use each other.
const SIMULATOR: &[&[&str]] = &[
    &["cli"],
    &["output"],
    &["study", "analysis"],
    &["engine"],
    &["simulation"],
    &["plant"],
    &["scene"],
    &["numerics", "input", "interrupt", "range", "notation", "table", "error"],
];

const CORE: &[&[&str]] = &[
    &["task"],
    &["board", "sync"],
    &["contract"],
    &["console"],
    &["device", "renderer"],
    &["experiment", "image", "safety", "self_test", "store", "telemetry"],
    &["control", "passivity", "period", "port", "settings", "wall"],
    &["velocity"],
    &["design"],
    &["actuator", "encoder"],
    &["units", "gain", "range", "crc"],
];

const BOARD_CRATES: &[&str] =
    &["virtual-board/cli/src", "lab/board-trials/src", "virtual-board/src"];

/// The layers of the virtual board, with its command line and the laboratory's commands.
const BOARD: &[&[&str]] = &[
    &["typed"],
    &["campaign", "fuzz"],
    &["link"],
    &["session"],
    &["world"],
    &["core_program", "device"],
    &["board"],
    &["amplifier", "rtt"],
    &["wiring"],
    &["mcu"],
    &["image", "elf", "log", "random", "threads"],
];

/// The layers of the live page's server.
const LIVE: &[&[&str]] = &[
    &["main"],
    &["server", "probe"],
    &["page", "picture"],
    &["hub"],
    &["seats", "access", "message", "predicted"],
    &["trigger", "spectrum"],
    &["history"],
];

/// Names of the crates of the laboratory. `LENDERS` are the files that offer a command of the laboratory.
const LABORATORY: &[&str] = &["board_trials", "lab_trade", "filter_forms", "host_sim_bench"];
const LENDERS: &[&str] = &[
    "host-sim/src/cli/trade.rs",
    "host-sim/src/output/trade_figures.rs",
    "virtual-board/cli/src/main.rs",
];
/// Folders of the crates that belong to kernel and product.
const PRODUCT: &[&str] = &[
    "src",
    "host-sim/src",
    "host-sim/studies/src",
    "host-sim/loop/src",
    "virtual-board/cli/src",
    "virtual-board/src",
    "live/src",
    "live/web/src",
    "python/src",
    "seal/src",
];

/// Finds the rules that the files of a crate break. Each rule has the lines that break it.
fn offences(source: &Source, layers: &[&[&str]]) -> BTreeMap<String, Vec<usize>> {
    let imports = source.imports();
    let mut found = BTreeMap::<_, Vec<_>>::new();
    for Import { from, to, file, line } in &imports {
        if rank(to, layers) < rank(from, layers) {
            found.entry(format!("{file} imports {}", to.join("::"))).or_default().push(*line);
        }
    }
    found.extend(circles(&imports).into_iter().map(|circle| (circle, vec![])));
    found
}

fn rank(module: &Module, layers: &[&[&str]]) -> usize {
    let place = layers.iter().position(|layer| layer.contains(&module[0].as_str()));
    place.unwrap_or_else(|| panic!("{} stands in no layer of this list", module[0]))
}

/// Finds the sets of files in which each file imports every other file of the set, directly or through other files.
fn circles(imports: &[Import]) -> Vec<String> {
    let related = |a: &Module, b: &Module| a.starts_with(b) || b.starts_with(a);
    let mut edges = BTreeMap::<&Module, BTreeSet<&Module>>::new();
    for Import { from, to, .. } in
        imports.iter().filter(|import| !related(&import.from, &import.to))
    {
        edges.entry(from).or_default().insert(to);
    }
    let reached = |from: &Module| {
        let mut found = BTreeSet::new();
        let mut open: Vec<&Module> = edges.get(from).into_iter().flatten().copied().collect();
        while let Some(module) = open.pop() {
            if found.insert(module) {
                open.extend(edges.get(module).into_iter().flatten());
            }
        }
        found
    };
    let all: BTreeMap<&Module, _> = edges.keys().map(|module| (*module, reached(module))).collect();
    let mut circles = BTreeSet::new();
    for (module, reached) in all.iter().filter(|(module, reached)| reached.contains(**module)) {
        let back =
            reached.iter().filter(|other| all.get(**other).is_some_and(|r| r.contains(*module)));
        circles.insert(back.map(|module| module.join("::")).collect::<Vec<_>>().join(", "));
    }
    circles.into_iter().map(|files| format!("a circle: {files}")).collect()
}

fn main() -> ExitCode {
    let simulator = Source::read(SIMULATOR_CRATES, &["host_sim", "sim_studies", "sim_loop"]);
    let core = Source::read(&["src"], &["zwidth"]);
    let mut found = offences(&simulator, SIMULATOR);
    found.extend(offences(&core, CORE));
    let board = Source::read(BOARD_CRATES, &["virtual_board", "board_trials"]);
    found.extend(offences(&board, BOARD));
    found.extend(offences(&Source::read(&["live/src"], &["live"]), LIVE));
    for folder in PRODUCT {
        for (file, line) in Source::read(&[folder], LABORATORY).mentions() {
            if !LENDERS.contains(&file) {
                let offence = format!("{file} names a crate of the laboratory");
                found.entry(offence).or_default().push(line);
            }
        }
    }
    for (offence, lines) in &found {
        eprintln!("error: {offence}, line {lines:?}");
    }
    ExitCode::from(u8::from(!found.is_empty()))
}

#[test]
fn a_crate_of_the_laboratory_is_found_where_it_is_named() {
    let text =
        "use std::fs;\nuse lab_trade::Bench;\nfn f() { lab_trade::g() }\n#[cfg(test)]\nmod tests;";
    let files = [("src/one.rs", text), ("src/one/tests.rs", "use lab_trade::Bench;")];
    let texts = files.map(|(name, text)| (name.to_owned(), text.to_owned())).to_vec();
    let source = Source::of(texts, &["src"], LABORATORY);
    assert_eq!(source.mentions(), [("src/one.rs", 2), ("src/one.rs", 3)]);
}

#[test]
fn what_is_against_the_rules_is_found_with_file_and_line() {
    let files = [
        ("low/mod.rs", "mod part;\npub use part::Part;\n#[cfg(test)]\nmod tests;"),
        ("low/part.rs", "// crate::high::High\nuse crate::{low, high::High};\npub struct Part;"),
        ("low/tests.rs", "use crate::high::High;"),
        ("low/left.rs", "fn left() -> &'static str { super::right::NAME; \"crate::high\" }"),
        ("low/right.rs", "const NAME: char = '\"'; // '\nuse super::left as other;"),
        ("high.rs", "pub struct High(crate::low::Part);\n#[cfg(test)] use crate::other::Other;"),
    ];
    let texts = files.map(|(name, text)| (format!("src/{name}"), text.to_owned())).to_vec();
    let found = offences(&Source::of(texts, &["src"], &["own"]), &[&["high"], &["low"]]);
    let lines: Vec<_> = found.iter().map(|(what, lines)| (what.as_str(), &lines[..])).collect();
    assert_eq!(
        lines,
        [
            ("a circle: high, low::part", &[][..]),
            ("a circle: low::left, low::right", &[]),
            ("src/low/part.rs imports high", &[2]),
        ]
    );
}
