//! The page without a server, for WebAssembly in a worker: the release ELF on the virtual board, and the simulator.
//!
//! The interface is plain: a worker asks for room with [`zwidth_input`], writes a question (JSON, then what belongs to it) there,
//! calls [`zwidth_ask`], and reads the answers. No bindings are generated, so the module needs no tool beside the compiler and
//! calls nothing of the browser. `assets/module.js` is the other end.
#![deny(unsafe_code)] // but for the names of the functions

mod board;
mod question;
mod study;
#[cfg(test)]
mod tests;

use std::{cell::RefCell, sync::Once};

pub use question::answer;

thread_local! {
    /// What a worker hands in, and what it gets.
    static IN: RefCell<Vec<Vec<u8>>> = const { RefCell::new(vec![]) };
    static OUT: RefCell<Vec<Vec<u8>>> = const { RefCell::new(vec![]) };
}

/// Room for `length` bytes, behind those that were handed in before. The answers of the question before are gone with it, so
/// that none of them is taken for what a panic said.
#[expect(unsafe_code, reason = "a name that the worker knows")]
#[unsafe(no_mangle)]
pub extern "C" fn zwidth_input(length: usize) -> *mut u8 {
    keep(vec![]);
    IN.with_borrow_mut(|all| {
        all.push(vec![0; length]);
        all.last_mut().map_or(std::ptr::null_mut(), Vec::as_mut_ptr)
    })
}

/// Answers what was handed in; how many answers there are. The first is JSON.
#[expect(unsafe_code, reason = "a name that the worker knows")]
#[unsafe(no_mangle)]
pub extern "C" fn zwidth_ask() -> usize {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        std::panic::set_hook(Box::new(|why| {
            keep(vec![why.to_string().into()]);
        }))
    });
    let given = IN.take();
    let answers = answer(given);
    keep(answers)
}

/// Where answer `number` is; of a panic, number 0 is what it said.
#[expect(unsafe_code, reason = "a name that the worker knows")]
#[unsafe(no_mangle)]
pub extern "C" fn zwidth_answer_at(number: usize) -> *const u8 {
    OUT.with_borrow(|all| all.get(number).map_or(std::ptr::null(), |bytes| bytes.as_ptr()))
}

/// How many bytes it has.
#[expect(unsafe_code, reason = "a name that the worker knows")]
#[unsafe(no_mangle)]
pub extern "C" fn zwidth_answer_length(number: usize) -> usize {
    OUT.with_borrow(|all| all.get(number).map_or(0, Vec::len))
}

fn keep(answers: Vec<Vec<u8>>) -> usize {
    let count = answers.len();
    OUT.set(answers);
    count
}
