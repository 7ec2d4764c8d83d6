//! Computes shifts and sums with their flags (ARM DDI 0403, A2.2.1 and A7.4.2).

use rsemu::cpu::arm::v7m::isa::{DpOp, Shift, ShiftType};

/// Shifts by a register's lowest byte. Returns the result and the carry.
pub(super) fn shift_by(kind: ShiftType, value: u32, amount: u32, carry: bool) -> (u32, bool) {
    if amount == 0 {
        return (value, carry);
    }
    let bit = |number: u32| value >> (number & 31) & 1 != 0;
    match (kind, amount) {
        (ShiftType::Lsl, 1..=31) => (value << amount, bit(32 - amount)),
        (ShiftType::Lsl, 32) => (0, bit(0)),
        (ShiftType::Lsr, 1..=31) => (value >> amount, bit(amount - 1)),
        (ShiftType::Lsr, 32) => (0, bit(31)),
        (ShiftType::Lsl | ShiftType::Lsr, _) => (0, false),
        (ShiftType::Asr, 1..=31) => {
            ((value.cast_signed() >> amount).cast_unsigned(), bit(amount - 1))
        }
        (ShiftType::Asr, _) => ((value.cast_signed() >> 31).cast_unsigned(), bit(31)),
        (ShiftType::Ror, _) => {
            (value.rotate_right(amount & 31), bit((amount & 31).wrapping_sub(1)))
        }
        (ShiftType::Rrx, _) => (u32::from(carry) << 31 | value >> 1, bit(0)),
    }
}

/// Shifts by a constant. Returns the result and the carry.
#[inline(always)]
pub(super) fn shift(shift: Shift, value: u32, carry: bool) -> (u32, bool) {
    if shift.is_none() {
        return (value, carry);
    }
    shift_by(shift.ty, value, shift.amount.into(), carry)
}

/// `a + b + carry`. Returns the sum, the carry and the overflow.
#[inline(always)]
fn sum(a: u32, b: u32, carry: bool) -> (u32, bool, bool) {
    let (partial, first) = a.overflowing_add(b);
    let (result, second) = partial.overflowing_add(carry.into());
    (result, first | second, ((a ^ result) & (b ^ result)) >> 31 != 0)
}

/// The flags before an operation, and the carry from the shift of its operand.
#[derive(Clone, Copy)]
pub(super) struct Before {
    pub(super) carry: bool,
    pub(super) shifted: bool,
    pub(super) overflow: bool,
}

/// Runs a data-processing operation. Returns the result, the carry and the overflow.
#[inline(always)]
pub(super) fn operate(op: DpOp, a: u32, b: u32, before: Before) -> (u32, bool, bool) {
    let logical = |result| (result, before.shifted, before.overflow);
    match op {
        DpOp::And | DpOp::Tst => logical(a & b),
        DpOp::Bic => logical(a & !b),
        DpOp::Orr => logical(a | b),
        DpOp::Orn => logical(a | !b),
        DpOp::Eor | DpOp::Teq => logical(a ^ b),
        DpOp::Mov => logical(b),
        DpOp::Mvn => logical(!b),
        DpOp::Add | DpOp::Cmn => sum(a, b, false),
        DpOp::Adc => sum(a, b, before.carry),
        DpOp::Sbc => sum(a, !b, before.carry),
        DpOp::Sub | DpOp::Cmp => sum(a, !b, true),
        DpOp::Rsb => sum(!a, b, true),
    }
}

/// The value that a load of `bytes` bytes puts into a register.
#[inline(always)]
pub(super) fn extended(value: u32, bytes: u32, signed: bool) -> u32 {
    let spare = 32 - 8 * bytes;
    if signed { ((value << spare).cast_signed() >> spare).cast_unsigned() } else { value }
}

/// The upper or lower half of a word, with its sign.
pub(super) fn half(value: u32, top: bool) -> i64 {
    let shifted = if top { value >> 16 } else { value };
    i64::from((shifted << 16).cast_signed() >> 16)
}

/// The nearest number that fits into `bits` bits, and whether it differs from `value`.
pub(super) fn saturated(value: i64, bits: u32, signed: bool) -> (u32, bool) {
    let bits = bits.min(32);
    let (least, most) =
        if signed { (-(1i64 << (bits - 1)), (1 << (bits - 1)) - 1) } else { (0, (1 << bits) - 1) };
    let result = value.clamp(least, most);
    (low(result.cast_unsigned()), result != value)
}

#[expect(clippy::cast_possible_truncation, reason = "the lower half")]
pub(super) fn low(value: u64) -> u32 {
    value as u32
}
