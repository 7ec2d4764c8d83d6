//! Uses RTT as a debug probe does, by reading and writing the control block in RAM. The board may be virtual, or real
//! and behind a probe.

use crate::mcu::Mcu;

/// Memory of a board whose program may run at the same time.
pub trait Memory {
    /// Reason why the memory could not be reached.
    type Error;

    /// Reads bytes from `address` on.
    fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), Self::Error>;

    /// Writes bytes from `address` on.
    ///
    /// # Errors
    /// The memory could not be reached. It is not known how many bytes were written.
    fn write(&mut self, address: u32, from: &[u8]) -> Result<(), Self::Error>;
}

impl Memory for Mcu {
    type Error = std::convert::Infallible;

    fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), Self::Error> {
        Mcu::read(self, address, into);
        Ok(())
    }

    fn write(&mut self, address: u32, from: &[u8]) -> Result<(), Self::Error> {
        Mcu::write(self, address, from);
        Ok(())
    }
}

const ID: &[u8] = b"SEGGER RTT";
const HEADER: u32 = 24;
const CHANNEL: u32 = 24;
/// Number of channels in both directions, the same as in the firmware.
const CHANNELS: u32 = 4;
/// Size of the control block with these channels, in bytes.
const BLOCK: usize = (HEADER + CHANNELS * CHANNEL) as usize;
/// Largest size of a buffer, in bytes. It is the size of RAM.
const LARGEST: u32 = 0x2_0000;

/// An RTT control block at a known address.
#[derive(Clone, Copy, Debug)]
pub struct Rtt {
    address: u32,
}

impl Rtt {
    /// The control block at `address`, which the ELF names `_SEGGER_RTT`.
    pub fn new(address: u32) -> Self {
        Self { address }
    }

    pub fn address(&self) -> u32 {
        self.address
    }

    /// Reads the control block with one access. Returns `None` if the program has not set up the block yet.
    pub fn look<M: Memory>(&self, memory: &mut M) -> Result<Option<Block>, M::Error> {
        let mut bytes = [0; BLOCK];
        memory.read(self.address, &mut bytes)?;
        Ok(bytes.starts_with(ID).then_some(Block { address: self.address, bytes }))
    }

    /// Address of the read offset in the command channel.
    pub fn commands_read(&self) -> u32 {
        self.address + HEADER + CHANNEL * (CHANNELS - 1) + 16
    }

    /// Takes the bytes in an up channel of a virtual board.
    pub fn read(&self, mcu: &mut Mcu, channel: u32) -> Vec<u8> {
        self.read_up_to(mcu, channel, usize::MAX)
    }

    /// Takes at most `room` bytes from an up channel.
    pub fn read_up_to(&self, mcu: &mut Mcu, channel: u32, room: usize) -> Vec<u8> {
        let Ok(block) = self.look(mcu);
        let Some(ring) = block.and_then(|block| block.up(channel)) else { return Vec::new() };
        let Ok((taken, next)) = ring.copy(mcu, room);
        let Ok(()) = ring.release(mcu, next);
        taken
    }

    /// Puts bytes into a down channel of a virtual board. Returns how many bytes had room.
    pub fn write(&self, mcu: &mut Mcu, channel: u32, bytes: &[u8]) -> usize {
        let Ok(block) = self.look(mcu);
        let Some(ring) = block.and_then(|block| block.down(channel)) else { return 0 };
        let Ok((count, next)) = ring.fill(mcu, bytes);
        let Ok(()) = ring.publish(mcu, next);
        count
    }

    /// Sets the mode of an up channel, as a debugger may do. The modes are 0 for skip, 1 for trim and 2 for block.
    pub fn set_mode(&self, mcu: &mut Mcu, channel: u32, mode: u32) {
        mcu.write(self.address + HEADER + CHANNEL * channel + 20, &mode.to_le_bytes());
    }
}

/// A control block at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    address: u32,
    bytes: [u8; BLOCK],
}

impl Block {
    /// Numbers of up and down channels in the block.
    pub fn counts(&self) -> [u32; 2] {
        [self.word(16), self.word(20)]
    }

    /// Addresses and sizes of the buffers, by channel. The program sets addresses and sizes once.
    pub fn buffers(&self) -> [[u32; 2]; CHANNELS as usize] {
        [0, 1, 2, 3].map(|index| {
            let ring = self.ring(index);
            [ring.buffer, ring.size]
        })
    }

    /// An up channel. `None` if its offsets lie outside its buffer, as in a damaged block.
    pub fn up(&self, channel: u32) -> Option<Ring> {
        let ring = (channel < CHANNELS).then(|| self.ring(channel))?;
        let is_sound = ring.size <= LARGEST && ring.read < ring.size && ring.write < ring.size;
        is_sound.then_some(ring)
    }

    /// A down channel, checked like [`up`](Self::up).
    pub fn down(&self, channel: u32) -> Option<Ring> {
        let index = self.counts()[0].checked_add(channel).filter(|index| *index < CHANNELS)?;
        let ring = self.ring(index);
        (ring.size <= LARGEST && ring.write < ring.size).then_some(ring)
    }

    fn ring(&self, index: u32) -> Ring {
        let start = HEADER + CHANNEL * index;
        let [buffer, size, write, read] = [4, 8, 12, 16].map(|offset| self.word(start + offset));
        Ring { at: self.address.wrapping_add(start), buffer, size, write, read }
    }

    fn word(&self, offset: u32) -> u32 {
        let at = offset as usize;
        self.bytes[at..at + 4].iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte))
    }
}

/// A channel's buffer at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ring {
    /// Address of the channel's descriptor in the control block.
    at: u32,
    buffer: u32,
    /// Size of the buffer, in bytes.
    size: u32,
    /// Offset at which the writer continues.
    pub write: u32,
    /// Offset at which the reader continues.
    pub read: u32,
}

impl Ring {
    /// Copies at most `room` bytes. Returns the bytes, and the reader's next offset. The bytes stay in the buffer.
    pub fn copy<M: Memory>(&self, memory: &mut M, room: usize) -> Result<(Vec<u8>, u32), M::Error> {
        let Self { buffer, size, write, mut read, .. } = *self;
        let mut taken = Vec::new();
        while read != write && taken.len() < room {
            let end = if write > read { write } else { size };
            let left = u32::try_from(room - taken.len()).unwrap_or(u32::MAX);
            let end = end.min(read.saturating_add(left));
            let mut piece = vec![0; (end - read) as usize];
            memory.read(buffer.wrapping_add(read), &mut piece)?;
            taken.extend(piece);
            read = end % size;
        }
        Ok((taken, read))
    }

    /// Frees the room of the bytes before `next`.
    pub fn release<M: Memory>(&self, memory: &mut M, next: u32) -> Result<(), M::Error> {
        memory.write(self.at.wrapping_add(16), &next.to_le_bytes())
    }

    /// Writes as many bytes as have room. Returns the number of written bytes, and the writer's next offset. Until
    /// [`publish`](Self::publish) the program does not see the bytes.
    pub fn fill<M: Memory>(&self, memory: &mut M, bytes: &[u8]) -> Result<(usize, u32), M::Error> {
        let Self { buffer, size, write, read, .. } = *self;
        // One byte stays free, since a full buffer must differ from an empty buffer.
        let room = if read < size { (read + size - write - 1) % size } else { size - 1 };
        let bytes = &bytes[..bytes.len().min(room as usize)];
        let (first, second) = bytes.split_at(bytes.len().min((size - write) as usize));
        for (at, piece) in [(write, first), (0, second)] {
            if !piece.is_empty() {
                memory.write(buffer.wrapping_add(at), piece)?;
            }
        }
        let count = u32::try_from(bytes.len()).unwrap_or(0);
        Ok((bytes.len(), (write + count) % size))
    }

    /// Makes the bytes before `next` visible to the program.
    ///
    /// # Errors
    /// The memory could not be reached. It is not known whether the program sees the bytes.
    pub fn publish<M: Memory>(&self, memory: &mut M, next: u32) -> Result<(), M::Error> {
        memory.write(self.at.wrapping_add(12), &next.to_le_bytes())
    }
}
