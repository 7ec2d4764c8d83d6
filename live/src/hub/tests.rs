//! Tests the hub with a simulated board that has only its channels.

use zwidth::telemetry::Frame;

use super::*;

/// The bytes that were sent to the board, and the bytes that can be read from each channel.
#[derive(Clone, Default)]
struct Board(Arc<Mutex<(String, [Vec<u8>; 3])>>);

impl Link for Board {
    fn read(&mut self, channel: usize, into: &mut Vec<u8>) {
        into.append(&mut lock(&self.0).1[channel]);
    }

    fn write(&mut self, channel: usize, bytes: &[u8]) -> usize {
        assert_eq!(channel, COMMANDS);
        // the channel has room for only three bytes at a time
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

/// Waits until the condition is true, for at most ten seconds.
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

/// Answers the first questions of the hub.
fn greet(board: &Board) {
    for (question, reply) in [
        ("version", "ok version 1"),
        ("estimator ?", "error: unknown estimator, allowed butterworth kalman-3 lev~"),
        ("get", "ok get k 0 N/m"),
        ("status", "ok status off"),
    ] {
        until(question, || count(board, question) == 1);
        board.says(reply);
    }
}

fn answers(hub: &Hub, command: &str) -> Vec<String> {
    let known = hub.known();
    let answers = known.lines.iter().filter(|line| line.answers.as_deref() == Some(command));
    answers.map(|line| line.text.clone()).collect()
}

#[test]
fn one_command_at_a_time_and_a_stop_before_all_that_waits() {
    let board = Board::default();
    let (hub, thread) = Hub::start(Box::new(board.clone()), None, None, None);
    greet(&board);
    for k in 1..=5 {
        assert_eq!(hub.command(&format!("k {k}"), None), Ok(()));
    }
    until("the first command", || count(&board, "k 1") == 1);
    thread::sleep(Duration::from_millis(30));
    assert_eq!(count(&board, "k 2"), 0, "before the first was answered");
    board.says("walk hit 1: k 1 N/m, b 1 N s/m, stable, rms 0.1 m");
    board.says("ok walk over, area 0 N^2 s/m^2");
    board.says("ok k 1 N/m");
    until("the second command", || count(&board, "k 2") == 1);
    let before = hub.stopped();
    hub.stop(7);
    assert!(hub.command("arm", Some(before)).is_err(), "of a page that does not know of the stop");
    assert_eq!(hub.command("get", Some(before + 1)), Ok(()));
    until("a stop", || count(&board, "disarm") == 1);
    board.says("ok k 2 N/m");
    board.says("ok disarm");
    until("the line behind it", || count(&board, "get") == 2);
    board.says("ok get k 2 N/m");
    until("its answer", || hub.known().stopped.iter().any(|stopped| stopped.id == 7));
    thread::sleep(REPLY + Duration::from_millis(50));
    assert_eq!(count(&board, "k 3"), 0, "what waited is forgotten");
    assert_eq!(answers(&hub, "k 1"), ["ok k 1 N/m"]);
    assert_eq!(answers(&hub, "k 2"), ["no reply to k 2: a stop came first"]);
    assert_eq!(answers(&hub, "k 5"), ["not sent: k 5"]);
    assert_eq!(answers(&hub, "disarm"), ["ok disarm"], "not the reply to what was sent before it");
    assert_eq!(answers(&hub, "get"), ["ok get k 2 N/m"]);
    let said: Vec<String> = hub.known().lines.iter().map(|line| line.text.clone()).collect();
    assert!(
        said.contains(&"ok k 1 N/m".to_owned()) && !said.contains(&"ok get k 0 N/m".to_owned())
    );
    for n in 0..WAITING {
        assert!(hub.command("status", None).is_ok() || n > WAITING - 3);
    }
    assert!(!(0..3).all(|_| hub.command("status", None).is_ok()), "an endless queue");
    hub.end();
    thread.join().unwrap();
    assert_eq!(count(&board, "disarm"), 2, "it leaves with the force off");
}

#[test]
fn the_promise_is_kept_while_somebody_is_there_and_no_longer() {
    let board = Board::default();
    let (hub, thread) = Hub::start(Box::new(board.clone()), None, None, None);
    greet(&board);
    hub.attend(Duration::MAX);
    hub.command("arm", None).unwrap();
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
    let end = hub.now() + 4 * WORD;
    hub.attend(end); // the last call, as if the server hangs
    until("off when nobody is there", || count(&board, "disarm") == 1);
    assert!(hub.now() > end, "while somebody is there");
    let words = count(&board, "alive 200");
    board.shows(1, Flags::default());
    // Without `alive 0`, the next user would have to send `alive` after `arm`.
    until("the end of the promise", || count(&board, "alive 0") == 1);
    assert_eq!(count(&board, "alive 200"), words);
    hub.end();
    thread.join().unwrap();
}

/// If an earlier host has sent an incomplete line, this line does not become a command. The reply to it is not taken
/// for a reply to this host.
#[test]
fn half_a_line_of_a_dead_host_is_ended_before_the_first_command() {
    let board = Board::default();
    lock(&board.0).0.push_str("k 12");
    let (hub, thread) = Hub::start(Box::new(board.clone()), None, None, None);
    until("a first question", || count(&board, "version") == 1);
    assert_eq!(board.lines()[..2], ["k 12?", "version"]);
    board.says("ok k 1 N/m");
    board.says("error: not a number of at most 15 digits such as 2000, 0.07 or 1.5e3: k N_PER_M");
    thread::sleep(Duration::from_millis(30));
    assert_eq!(count(&board, "estimator ?"), 0, "the reply to version has not come");
    greet(&board);
    until("its settings", || hub.known().settings == "ok get k 0 N/m");
    assert_eq!(hub.known().version, "ok version 1");
    assert!(hub.known().lines.is_empty(), "what another host asked");
    // If the list is cut off, its last name may be incomplete.
    assert_eq!(hub.known().estimators, ["butterworth", "kalman-3"]);
    hub.end();
    thread.join().unwrap();
    assert_eq!(count(&board, "?"), 0, "no line is ended that was not begun");
}

#[test]
fn a_save_is_waited_for_as_long_as_an_erase_takes() {
    let board = Board::default();
    let (hub, thread) = Hub::start(Box::new(board.clone()), None, None, None);
    greet(&board);
    hub.command("save", None).unwrap();
    until("save", || count(&board, "save") == 1);
    thread::sleep(2 * REPLY);
    board.says("ok save");
    until("its end", || answers(&hub, "save") == ["ok save"]);
    hub.command("save", None).unwrap();
    until("a reply that does not come", || {
        answers(&hub, "save").iter().any(|text| text.starts_with("no reply to save"))
    });
    hub.end();
    thread.join().unwrap();
}

#[test]
fn a_board_that_was_reset_is_asked_anew() {
    let board = Board::default();
    let (hub, thread) = Hub::start(Box::new(board.clone()), None, None, None);
    greet(&board);
    board.shows(7, Flags::default());
    until("a row", || hub.known().record.is_some());
    until("its settings", || count(&board, "get") == 2);
    board.says("ok get k 0 N/m");
    hub.command("k 3", None).unwrap();
    until("a command", || count(&board, "k 3") == 1);
    board.shows(0, Flags::default());
    until("version", || count(&board, "version") == 2);
    assert_eq!(answers(&hub, "k 3"), ["no reply to k 3: the board was reset"]);
    board.says("ok version 2");
    until("its estimators", || count(&board, "estimator ?") == 2);
    hub.end();
    thread.join().unwrap();
}
