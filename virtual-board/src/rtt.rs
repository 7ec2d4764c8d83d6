//! RTT, the way a debug probe does it: by reading and writing the control block in RAM.

use crate::mcu::Mcu;

const ID: &[u8] = b"SEGGER RTT";
const HEADER: u32 = 24;
const CHANNEL: u32 = 24;
/// No buffer is larger, bytes: RAM.
const LARGEST: u32 = 0x2_0000;

/// An RTT control block at a known address.
#[derive(Clone, Copy, Debug)]
pub struct Rtt {
    address: u32,
}

impl Rtt {
    /// The control block at `address`, the ELF's symbol `_SEGGER_RTT`.
    pub fn new(address: u32) -> Self {
        Self { address }
    }

    /// Whether the program has set it up.
    pub fn is_ready(&self, mcu: &Mcu) -> bool {
        let mut id = [0; 10];
        mcu.read(self.address, &mut id);
        id == ID
    }

    /// Takes what an up channel holds.
    pub fn read(&self, mcu: &mut Mcu, channel: u32) -> Vec<u8> {
        self.read_up_to(mcu, channel, usize::MAX)
    }

    /// Takes that many bytes of it at most.
    pub fn read_up_to(&self, mcu: &mut Mcu, channel: u32, room: usize) -> Vec<u8> {
        let mut taken = Vec::new();
        if !self.is_ready(mcu) {
            return taken;
        }
        let at = self.address + HEADER + CHANNEL * channel;
        let [buffer, size, write, mut read] =
            [4, 8, 12, 16].map(|offset| word(mcu, at.wrapping_add(offset)));
        // What the program has lost is none.
        if size > LARGEST || read >= size || write >= size {
            return taken;
        }
        while read != write && taken.len() < room {
            let end = if write > read { write } else { size };
            let left = u32::try_from(room - taken.len()).unwrap_or(u32::MAX);
            let end = end.min(read.saturating_add(left));
            let mut piece = vec![0; (end - read) as usize];
            mcu.read(buffer.wrapping_add(read), &mut piece);
            taken.extend(piece);
            read = end % size;
        }
        mcu.write(at + 16, &read.to_le_bytes());
        taken
    }

    /// Puts bytes into a down channel; returns how many went in.
    pub fn write(&self, mcu: &mut Mcu, channel: u32, bytes: &[u8]) -> usize {
        if !self.is_ready(mcu) {
            return 0;
        }
        let at = self.down(mcu, channel);
        let [buffer, size, mut write, read] =
            [4, 8, 12, 16].map(|offset| word(mcu, at.wrapping_add(offset)));
        let mut written = 0;
        if size == 0 || size > LARGEST || write >= size {
            return 0;
        }
        for byte in bytes {
            if (write + 1) % size == read {
                break;
            }
            mcu.write(buffer.wrapping_add(write), &[*byte]);
            write = (write + 1) % size;
            written += 1;
        }
        mcu.write(at.wrapping_add(12), &write.to_le_bytes());
        written
    }

    /// Writes an up channel's mode word, as a debugger may: 0 skip, 1 trim, 2 block.
    pub fn set_mode(&self, mcu: &mut Mcu, channel: u32, mode: u32) {
        mcu.write(self.address + HEADER + CHANNEL * channel + 20, &mode.to_le_bytes());
    }

    fn down(&self, mcu: &Mcu, channel: u32) -> u32 {
        let up_channels = word(mcu, self.address + 16);
        self.address.wrapping_add(HEADER + CHANNEL.wrapping_mul(up_channels.wrapping_add(channel)))
    }
}

fn word(mcu: &Mcu, address: u32) -> u32 {
    let mut bytes = [0; 4];
    mcu.read(address, &mut bytes);
    u32::from_le_bytes(bytes)
}
