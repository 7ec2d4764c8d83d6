//! A stand-in for a board, at the level of channels.

use zwidth::telemetry::Frame;

use super::*;

/// What was sent, and what is to be read on each channel.
#[derive(Clone, Default)]
struct Board(Arc<Mutex<(String, [Vec<u8>; 3])>>);

impl Link for Board {
    fn read(&mut self, channel: usize, into: &mut Vec<u8>) {
        into.append(&mut lock(&self.0).1[channel]);
    }

    fn write(&mut self, channel: usize, bytes: &[u8]) -> usize {
        assert_eq!(channel, COMMANDS);
        // Room for three bytes at a time.
        let some = &bytes[..bytes.len().min(3)];
        lock(&self.0).0.push_str(std::str::from_utf8(some).unwrap());
        some.len()
    }

    fn lost(&self) -> Option<String> {
        None
    }
}

impl Board {
    fn says(&self, line: &str) {
        lock(&self.0).1[REPLIES].extend(format!("{line}\n").bytes());
    }

    fn shows(&self, sequence: u32, flags: Flags) {
        let record = Record { sample: u64::from(sequence) * 10, flags, ..Record::EMPTY };
        lock(&self.0).1[TELEMETRY].extend(Frame { sequence, record }.encode());
    }

    fn lines(&self) -> Vec<String> {
        lock(&self.0).0.lines().map(str::to_owned).collect()
    }
}

/// Waits for it, ten seconds at most.
fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(10);
    while !is_so() {
        assert!(Instant::now() < end, "{what}");
        thread::sleep(Duration::from_millis(1));
    }
}

fn count(board: &Board, wanted: &str) -> usize {
    board.lines().iter().filter(|line| *line == wanted).count()
}

/// What the board is asked by itself at first.
fn greet(board: &Board) {
    until("a first question", || count(board, "version") == 1);
    board.says("ok version 1");
    until("a second question", || count(board, "get") == 1);
    board.says("ok get k 0 N/m");
}

#[test]
fn one_command_at_a_time_and_a_stop_before_all_that_waits() {
    let board = Board::default();
    let (hub, thread) = Hub::start(Box::new(board.clone()), None, None, None);
    greet(&board);
    for k in 1..=5 {
        assert!(hub.command(&format!("k {k}")));
    }
    until("the first command", || count(&board, "k 1") == 1);
    thread::sleep(Duration::from_millis(30));
    assert_eq!(count(&board, "k 2"), 0, "before the first was answered");
    board.says("walk hit 1: k 1 N/m, b 1 N s/m, stable, rms 0.1 m");
    board.says("ok k 1 N/m");
    until("the second command", || count(&board, "k 2") == 1);
    hub.stop(7);
    until("a stop", || count(&board, "disarm") == 1);
    board.says("ok disarm");
    until("its answer", || hub.known().stopped.iter().any(|stopped| stopped.id == 7));
    thread::sleep(REPLY + Duration::from_millis(50));
    assert_eq!(count(&board, "k 3"), 0, "what waited is forgotten");
    let said: Vec<String> = hub.known().lines.iter().map(|line| line.text.clone()).collect();
    assert!(
        said.contains(&"ok k 1 N/m".to_owned()) && !said.contains(&"ok get k 0 N/m".to_owned())
    );
    for n in 0..WAITING {
        assert!(hub.command("status") || n > WAITING - 3);
    }
    assert!(!(0..3).all(|_| hub.command("status")), "an endless queue");
    hub.end();
    thread.join().unwrap();
    assert_eq!(count(&board, "disarm"), 2, "it leaves with the force off");
}

#[test]
fn the_promise_is_kept_while_somebody_is_there_and_no_longer() {
    let board = Board::default();
    let (hub, thread) = Hub::start(Box::new(board.clone()), None, None, None);
    greet(&board);
    hub.attended.store(true, Relaxed);
    hub.command("arm");
    until("arm", || count(&board, "arm") == 1);
    let lines = board.lines();
    let place = |wanted: &str| lines.iter().position(|line| line == wanted).unwrap();
    assert!(place("alive 200") < place("arm"), "force without a promise");
    board.says("ok alive");
    board.says("ok arm");
    board.shows(0, Flags::ON);
    let begun = Instant::now();
    until("words", || count(&board, "alive 200") >= 6);
    assert!(begun.elapsed() > 3 * WORD, "as often as that");
    assert_eq!(count(&board, "disarm"), 0);
    hub.attended.store(false, Relaxed);
    until("off when nobody is there", || count(&board, "disarm") == 1);
    let words = count(&board, "alive 200");
    board.shows(1, Flags::default());
    // Else whoever arms next would have to keep it.
    until("the end of the promise", || count(&board, "alive 0") == 1);
    assert_eq!(count(&board, "alive 200"), words);
    hub.end();
    thread.join().unwrap();
}
