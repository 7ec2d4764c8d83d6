//! The compiled control path has no panic, no formatting and no soft-float call. The test follows the relocations of
//! the object files to every function that the three entry points can reach.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
};

use object::{Object, ObjectSection, ObjectSymbol, RelocationTarget, read::archive::ArchiveFile};
use virtual_board::image;

/// Parts of symbols that must not be reachable: panics and their messages, formatting, soft-float.
const FORBIDDEN: [&str; 8] =
    ["panic", "core3fmt", "_fail", "unwrap", "__aeabi_d", "__aeabi_f", "__aeabi_l2", "rust_begin"];

/// The object files of tests/on-target/src/lib.rs.
fn archive(features: &[&str]) -> Vec<u8> {
    fs::read(image::build_on_target("libon_target.a", features).unwrap()).unwrap()
}

/// Maps each function to the names that its code refers to.
fn call_graph(archive: &[u8]) -> BTreeMap<String, BTreeSet<String>> {
    let mut graph = BTreeMap::<String, BTreeSet<String>>::new();
    for member in ArchiveFile::parse(archive).unwrap().members() {
        let Ok(file) = object::File::parse(member.unwrap().data(archive).unwrap()) else {
            continue;
        };
        for symbol in file.symbols().filter(|symbol| symbol.is_definition()) {
            let Some(index) = symbol.section_index() else { continue };
            let section = file.section_by_index(index).unwrap();
            let callees = graph.entry(symbol.name().unwrap().to_owned()).or_default();
            // Each function has its own section, so all relocations of the section belong to the function.
            for (_, relocation) in section.relocations() {
                if let RelocationTarget::Symbol(target) = relocation.target() {
                    let target = file.symbol_by_index(target).unwrap();
                    let name = match target.section_index() {
                        Some(index) if target.name().unwrap_or_default().is_empty() => {
                            file.section_by_index(index).unwrap().name().unwrap().to_owned()
                        }
                        _ => target.name().unwrap().to_owned(),
                    };
                    callees.insert(name);
                }
            }
        }
    }
    graph
}

/// All functions that `entry` can reach, including `entry`.
fn reachable(graph: &BTreeMap<String, BTreeSet<String>>, entry: &str) -> BTreeSet<String> {
    assert!(graph.contains_key(entry), "{entry} is not in the object files");
    let mut found = BTreeSet::from([entry.to_owned()]);
    let mut open = vec![entry.to_owned()];
    while let Some(function) = open.pop() {
        for callee in graph.get(&function).into_iter().flatten() {
            if found.insert(callee.clone()) {
                open.push(callee.clone());
            }
        }
    }
    found
}

fn forbidden(names: &BTreeSet<String>) -> Vec<&String> {
    names.iter().filter(|name| FORBIDDEN.iter().any(|bad| name.contains(bad))).collect()
}

#[test]
#[ignore = "a program of its own for the target; CI runs it"]
fn the_control_path_has_no_panic_no_formatting_and_no_soft_float() {
    let graph = call_graph(&archive(&[]));
    for entry in [
        "zwidth_sample",
        "zwidth_render",
        "zwidth_hit",
        "zwidth_trial",
        "zwidth_calibration",
        "zwidth_guarded_sample",
        "zwidth_supervised_render",
        "zwidth_request",
        "zwidth_keep",
    ] {
        let names = reachable(&graph, entry);
        println!("{entry}: {names:?}");
        assert_eq!(forbidden(&names), Vec::<&String>::new(), "{entry}");
    }
    // The search does find a call that exists.
    let settings = reachable(&graph, "zwidth_build");
    assert!(settings.iter().any(|name| name.contains("__aeabi_d")), "{settings:?}");
}

#[test]
#[ignore = "a program of its own for the target; CI runs it"]
fn link_and_store_have_no_panic() {
    let graph = call_graph(&archive(&[]));
    for entry in ["zwidth_memory", "zwidth_link", "zwidth_reply", "zwidth_envelope", "zwidth_store"]
    {
        let names = reachable(&graph, entry);
        println!("{entry}: {names:?}");
        let panics = ["panic", "_fail", "unwrap", "rust_begin"];
        let found = names.iter().find(|name| panics.iter().any(|bad| name.contains(bad)));
        assert_eq!(found, None, "{entry}");
    }
}

#[test]
#[ignore = "a program of its own for the target; CI runs it"]
fn no_estimator_has_a_panic_formatting_or_soft_float() {
    let graph = call_graph(&archive(&["estimators"]));
    let names = reachable(&graph, "zwidth_estimate");
    println!("{names:?}");
    let forms = names.iter().filter(|name| name.contains("8velocity6called")).count();
    assert!(forms > 7, "{forms} forms are compiled in");
    assert_eq!(forbidden(&names), Vec::<&String>::new());
}

/// Number of Thumb-2 instructions in a function. The literals after its code do not count.
fn instructions(archive: &[u8], function: &str) -> usize {
    for member in ArchiveFile::parse(archive).unwrap().members() {
        let Ok(file) = object::File::parse(member.unwrap().data(archive).unwrap()) else {
            continue;
        };
        let Some(symbol) = file.symbol_by_name(function) else { continue };
        let Some(index) = symbol.section_index() else { continue };
        let code = file.section_by_index(index).unwrap().data().unwrap();
        let start = (symbol.address() & !1) as usize;
        let code = &code[start..start + symbol.size() as usize];
        let (mut at, mut count) = (0, 0);
        while at + 1 < code.len() {
            let half = u16::from_le_bytes([code[at], code[at + 1]]);
            at += if half >= 0xE800 { 4 } else { 2 }; // Armv7-M manual, A5.1: 11101, 11110, 11111
            count += 1;
        }
        return count;
    }
    panic!("{function} is not in the object files");
}

#[test]
#[ignore = "a program of its own for the target; CI runs it"]
fn the_filter_costs_little_more_than_the_peers_that_do_less() {
    let archive = archive(&[]);
    let graph = call_graph(&archive);
    let names = [
        "zwidth_filter",
        "idsp_dither",
        "idsp_wide",
        "zwidth_sample",
        "zwidth_render",
        "zwidth_guarded_sample",
        "zwidth_supervised_render",
    ];
    // Includes called functions of this project, except for functions whose name marks a rare case.
    let total = |name: &str| -> usize {
        let called = reachable(&graph, name);
        let often = called.iter().filter(|function| {
            (function.contains("zwidth") || *function == name)
                && graph.contains_key(*function)
                && !function.contains("9take_over")
        });
        often.map(|function| instructions(&archive, function)).sum()
    };
    for name in names {
        println!("{name}: {} instructions", total(name));
        crate::figure::figure(&format!("elf/control_path/{name}"), total(name));
    }
    // The code has no loop, so the length of the code limits the number of instructions that run. The core's part may
    // take at most 150 cycles per sample.
    assert!((80..=150).contains(&total("zwidth_sample")));
    // The guard, its record and its rare work are inlined and add to the core's part. tests/elf/control counts the
    // cycles of a sample.
    assert!((130..=300).contains(&total("zwidth_guarded_sample")));
}
