//! A program on the board's emulated core. The program gets a job and samples through memory, and returns velocities
//! and the cycles of each update. `tests/on-target/src/mailbox.rs` is the program's side.

use virtual_board::{
    elf::Elf,
    image,
    mcu::{Chip, Listeners, Mcu},
};

pub struct Mailbox {
    mcu: Mcu,
    elf: Elf,
    job: u32,
    sample: u32,
    cycles: u32,
}

impl Mailbox {
    /// Builds the program and boots it. Fails if the image contains a panic.
    pub fn of(program: &str, features: &[&str]) -> Self {
        let elf = Elf::load(&image::build_on_target(program, features).unwrap()).unwrap();
        for (name, ..) in &elf.symbols {
            assert!(!name.contains("panicking"), "{name} is in the image");
        }
        let chip =
            Chip { core_hz: 180_000_000, flash_bytes: 0x8_0000, id: 0x421, over_drive: true };
        let [job, sample, cycles] =
            ["JOB", "SAMPLE", "CYCLES"].map(|name| elf.address_of(name).unwrap());
        let mut mcu = Mcu::new(chip, &elf.flash, Listeners::default());
        mcu.run_until(1_000_000).unwrap();
        Self { mcu, elf, job, sample, cycles }
    }

    /// Writes words to the program's variable with this name.
    pub fn set(&mut self, name: &str, words: &[u32]) {
        let address = self.elf.address_of(name).unwrap();
        self.write(address, words);
    }

    /// Returns the velocities, the cycles of each update, and the number of bytes that the program has written after
    /// the job. `job` has the words after the state. The last word of `job` is the number of samples.
    pub fn run(&mut self, what: &str, job: &[u32], inputs: &[i32]) -> (Vec<i32>, Vec<u32>, u32) {
        let words: Vec<u32> = inputs.iter().map(|input| input.cast_unsigned()).collect();
        self.write(self.sample, &words);
        self.write(self.job + 4, job);
        self.write(self.job, &[1]);
        for _ in 0..1000 {
            self.mcu.run_until(self.mcu.now() + 100_000).unwrap();
            let state = self.words(self.job, 1)[0];
            assert_ne!(state, 3, "{what} is refused by the target");
            if state == 2 {
                let velocities = self.words(self.sample, inputs.len());
                let velocities = velocities.into_iter().map(u32::cast_signed).collect();
                let cycles = self.words(self.cycles, inputs.len());
                let bytes = self.words(self.job + 4, job.len() + 1)[job.len()];
                return (velocities, cycles, bytes);
            }
        }
        panic!("{what} does not end");
    }

    fn words(&self, address: u32, count: usize) -> Vec<u32> {
        let mut bytes = vec![0; 4 * count];
        self.mcu.read(address, &mut bytes);
        bytes.chunks_exact(4).map(|word| u32::from_le_bytes(word.try_into().unwrap())).collect()
    }

    fn write(&mut self, address: u32, words: &[u32]) {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        self.mcu.write(address, &bytes);
    }
}

/// The row with this name in a table of costs. A row has the name, the cycles, and other cells.
pub fn cost_row<'a>(file: &str, table: &'a str, name: &str) -> Vec<&'a str> {
    let mut rows = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    rows.find(|row| row[0] == name).unwrap_or_else(|| panic!("{file} has no row {name}"))
}

/// Checks that the cycles in the second cell of a table's row equal a measurement within 2 %. Returns the cells of the
/// row.
pub fn assert_cost<'a>(file: &str, table: &'a str, name: &str, cycles: u32) -> Vec<&'a str> {
    let row = cost_row(file, table, name);
    let stated: f64 = row[1].parse().unwrap();
    let off = f64::from(cycles) / stated - 1.0;
    assert!(off.abs() <= 0.02, "{name}: {cycles} cycles, {file} has {stated}");
    row
}
