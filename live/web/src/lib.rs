//! The page without a server. It is WebAssembly in a worker, with the release ELF on the virtual board, and the
//! simulator.
//!
//! The interface has four functions. A worker gets memory by [`zwidth_input`], and writes a question there: first JSON,
//! then the question's data. Then the worker calls [`zwidth_ask`] and reads the answers. No bindings are generated. So
//! the module needs only the compiler, and calls no function of the browser. `assets/module.js` is the worker's side.
#![deny(unsafe_code)] // except for the exported names

mod board;
mod question;
mod study;
#[cfg(test)]
mod tests;

use std::{cell::RefCell, sync::Once};

pub use question::answer;

thread_local! {
    /// `IN` has the data from the worker, and `OUT` has the answers to this data.
    static IN: RefCell<Vec<Vec<u8>>> = const { RefCell::new(vec![]) };
    static OUT: RefCell<Vec<Vec<u8>>> = const { RefCell::new(vec![]) };
}

/// Allocates `length` bytes after the memory of earlier calls. The previous answers are cleared, so that they are not
/// taken for the message of a panic.
#[expect(unsafe_code, reason = "a name that the worker knows")]
#[unsafe(no_mangle)]
pub extern "C" fn zwidth_input(length: usize) -> *mut u8 {
    keep(vec![]);
    IN.with_borrow_mut(|all| {
        all.push(vec![0; length]);
        all.last_mut().map_or(std::ptr::null_mut(), Vec::as_mut_ptr)
    })
}

/// Answers the question. Returns the number of answers. The first answer is JSON.
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

/// Address of the answer with this number. After a panic, answer 0 is the panic's message.
#[expect(unsafe_code, reason = "a name that the worker knows")]
#[unsafe(no_mangle)]
pub extern "C" fn zwidth_answer_at(number: usize) -> *const u8 {
    OUT.with_borrow(|all| all.get(number).map_or(std::ptr::null(), |bytes| bytes.as_ptr()))
}

/// Length of the answer with this number, in bytes.
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
