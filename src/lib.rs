//! zwidth
#![no_std]
