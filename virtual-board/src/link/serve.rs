//! `cargo board serve`: offers the virtual board to other tools as RTT over TCP, on the loopback interface.

use std::{
    io::{self, ErrorKind, Read as _, Write as _},
    net::{Ipv4Addr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    thread,
    time::Duration,
};

use host_sim::{
    error::Error,
    interrupt,
    output::terminal::{note, print_text},
};

use super::{Begin, LOOK, Link as _, LiveBoard, PATIENCE, at_once};
use crate::session::Session;

/// Number of attempts to find consecutive free ports, if port 0 was given.
const TRIES: usize = 100;

/// Ports on which the server listens. 0 stands for any free port.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ports {
    /// The first of three consecutive ports.
    pub rtt: u16,
    pub gdb: Option<u16>,
}

/// A virtual board behind three TCP ports. Dropping this value switches the board off.
pub struct Server {
    /// Port of channel 0. The other channels have the ports after it.
    pub port: u16,
    pub gdb: Option<u16>,
    pub board: Arc<LiveBoard>,
    over: Arc<AtomicBool>,
    threads: Vec<thread::JoinHandle<()>>,
}

impl Server {
    /// Listens on the ports, then switches the board on.
    ///
    /// # Errors
    /// A port is in use, or the image refuses a command.
    pub fn start(session: Session, period: Option<u32>, ports: Ports) -> Result<Self, Error> {
        let (port, listeners) = listen(ports.rtt)?;
        let gdb = ports.gdb.map(listen_for_gdb).transpose()?;
        let (gdb, listener) = gdb.unzip();
        let begin = Begin { zeroed: false, period };
        let board = Arc::new(LiveBoard::with_gdb(session, begin, listener)?);
        let over = Arc::new(AtomicBool::new(false));
        let serve = |(channel, listener): (usize, TcpListener)| {
            let (board, over) = (Arc::clone(&board), Arc::clone(&over));
            thread::spawn(move || channel_of(channel, &listener, &board, &over))
        };
        let threads = listeners.into_iter().enumerate().map(serve).collect();
        Ok(Self { port, gdb, board, over, threads })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.over.store(true, Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Serves until the user presses Ctrl-C, or until the board's program ends.
///
/// # Errors
/// The same errors as in [`Server::start`], or the board's program has ended.
pub fn serve(session: Session, period: Option<u32>, ports: Ports) -> Result<(), Error> {
    let server = Server::start(session, period, ports)?;
    let first = server.port;
    print_text(&format!("127.0.0.1:{first}"))?;
    if let Some(gdb) = server.gdb {
        print_text(&format!("127.0.0.1:{gdb}"))?;
        note(&format!(
            "gdb: target remote 127.0.0.1:{gdb}; its halts are a debugger's halts: keep the force off"
        ));
    }
    note(&format!(
        "RTT of the virtual board in real time: log on port {first}, telemetry on {}, replies on {}; commands go to \
         {first}; end with Ctrl-C",
        first + 1,
        first + 2
    ));
    let link = server.board.wires.link();
    loop {
        thread::sleep(Duration::from_millis(20));
        interrupt::check()?;
        if let Some(text) = link.lost() {
            return Err(Error::Internal(text));
        }
    }
}

/// Listens on consecutive ports, one for each channel. Only programs on this machine can connect.
fn listen(port: u16) -> Result<(u16, Vec<TcpListener>), Error> {
    let bind = |port: u16| TcpListener::bind((Ipv4Addr::LOCALHOST, port));
    let row = |first: TcpListener| -> io::Result<(u16, Vec<TcpListener>)> {
        let port = first.local_addr()?.port();
        let mut all = vec![first];
        for n in 1..3u16 {
            let next = port.checked_add(n).ok_or(ErrorKind::AddrNotAvailable)?;
            all.push(bind(next)?);
        }
        all.iter().try_for_each(|listener| listener.set_nonblocking(true))?;
        Ok((port, all))
    };
    let tries = if port == 0 { TRIES } else { 1 };
    let mut last = io::Error::from(ErrorKind::AddrInUse);
    for _ in 0..tries {
        match bind(port).and_then(row) {
            Ok(found) => return Ok(found),
            Err(error) => last = error,
        }
    }
    Err(Error::Input(format!("--rtt {port}: this port and the two after it: {last}")))
}

fn listen_for_gdb(port: u16) -> Result<(u16, TcpListener), Error> {
    let bound = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok((listener.local_addr()?.port(), listener))
    });
    bound.map_err(|error| Error::Input(format!("--gdb {port}: this port: {error}")))
}

/// Serves one client at a time. Other clients wait, since a debug probe also serves one program at a time.
fn channel_of(channel: usize, listener: &TcpListener, board: &LiveBoard, over: &AtomicBool) {
    while !over.load(Relaxed) {
        match listener.accept() {
            Ok((client, _)) => {
                // A client that disconnects is no error of the board.
                let _ = attend(channel, client, board, over);
                board.wires.attend(channel, false);
            }
            Err(_) => thread::sleep(Duration::from_millis(5)),
        }
    }
}

fn attend(
    channel: usize,
    mut client: TcpStream,
    board: &LiveBoard,
    over: &AtomicBool,
) -> io::Result<()> {
    client.set_nonblocking(true)?;
    client.set_nodelay(true)?;
    let mut link = board.wires.link();
    let (mut up, mut down, mut bytes) = (Vec::new(), Vec::new(), [0; 4096]);
    let mut stuck = Duration::ZERO;
    while !over.load(Relaxed) {
        if up.is_empty() {
            link.read(channel, &mut up);
        }
        let mut idle = true;
        match at_once(client.write(&up))? {
            Some(count) => {
                up.drain(..count);
                stuck = Duration::ZERO;
            }
            None => stuck += LOOK,
        }
        if stuck > PATIENCE {
            return Err(ErrorKind::TimedOut.into());
        }
        // If the board has no room, bytes stay in the socket. If the socket is also full, the bytes stay with the
        // client.
        if down.is_empty() {
            match at_once(client.read(&mut bytes))? {
                Some(0) => return Ok(()),
                count => down.extend_from_slice(&bytes[..count.unwrap_or(0)]),
            }
        }
        if !down.is_empty() {
            let sent =
                if channel == super::COMMANDS { link.write(channel, &down) } else { down.len() };
            down.drain(..sent);
            idle = sent == 0;
        }
        if idle {
            thread::sleep(LOOK);
        }
    }
    Ok(())
}
