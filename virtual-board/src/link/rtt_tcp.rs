//! Connects to RTT over TCP. Each channel has its own port, as with OpenOCD's `rtt server`.

use std::{
    io::{Read as _, Write as _},
    net::{TcpStream, ToSocketAddrs as _},
    time::Duration,
};

use super::{Link, UP_CHANNELS, at_once};

/// Longest time for a server to answer.
const CONNECT: Duration = Duration::from_secs(3);

/// A board behind a server. Up and down channel n use TCP port P + n.
pub struct RttTcp {
    channels: [TcpStream; UP_CHANNELS],
    lost: Option<String>,
}

impl RttTcp {
    /// Connects to the port in `HOST:PORT` and to the ports that follow it.
    ///
    /// # Errors
    /// The address is not valid, or no server answers there. The error is one line of text.
    pub fn connect(address: &str) -> Result<Self, String> {
        let (host, port) = address
            .rsplit_once(':')
            .and_then(|(host, port)| Some((host, port.parse::<u16>().ok()?)))
            .filter(|(_, port)| u16::MAX - port >= 2)
            .ok_or_else(|| format!("{address} is no HOST:PORT with two ports after it"))?;
        let mut channels = Vec::with_capacity(UP_CHANNELS);
        for n in 0..3 {
            let place = (host.trim_matches(['[', ']']), port + n);
            let failed = |error: std::io::Error| format!("{host}:{}: {error}", port + n);
            let addresses = place.to_socket_addrs().map_err(failed)?;
            let mut last = format!("{host} has no address");
            let stream = addresses.into_iter().find_map(|to| {
                let connected = TcpStream::connect_timeout(&to, CONNECT);
                connected.map_err(|error| last = failed(error)).ok()
            });
            let stream = stream.ok_or(last)?;
            stream.set_nonblocking(true).map_err(failed)?;
            stream.set_nodelay(true).map_err(failed)?;
            channels.push(stream);
        }
        let channels = channels.try_into().map_err(|_| "three channels".to_owned())?;
        Ok(Self { channels, lost: None })
    }
}

impl Link for RttTcp {
    fn read(&mut self, channel: usize, into: &mut Vec<u8>) {
        let Some(stream) = self.channels.get_mut(channel) else { return };
        let mut bytes = [0; 4096];
        while self.lost.is_none() {
            match at_once(stream.read(&mut bytes)) {
                Ok(Some(0)) => self.lost = Some("the server closed the connection".to_owned()),
                Ok(Some(count)) => into.extend_from_slice(&bytes[..count]),
                Ok(None) => return,
                Err(error) => self.lost = Some(error.to_string()),
            }
        }
    }

    fn write(&mut self, channel: usize, bytes: &[u8]) -> usize {
        let Some(stream) = self.channels.get_mut(channel) else { return 0 };
        let written = at_once(stream.write(bytes));
        written.map_err(|error| self.lost = Some(error.to_string())).ok().flatten().unwrap_or(0)
    }

    fn lost(&self) -> Option<String> {
        self.lost.clone()
    }
}
