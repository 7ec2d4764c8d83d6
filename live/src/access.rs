//! The access rules: only this server's own page gets answers, and only on this machine.

/// Length of the longest message that a page may send, in bytes.
pub const MESSAGE_MAX: usize = 4096;
/// Largest number of pages that may be open.
pub const PAGES_MAX: usize = 16;
/// Largest number of messages that a page may send per second. A mouse sends 125.
pub const MESSAGES_PER_S: u32 = 400;

/// The secret token of this run, and the server's port.
#[derive(Clone, Debug)]
pub struct Access {
    token: String,
    port: u16,
}

impl Access {
    pub fn new(secret: [u8; 16], port: u16) -> Self {
        let token = secret.iter().map(|byte| format!("{byte:02x}")).collect();
        Self { token, port }
    }

    /// The address to open in a browser.
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/?token={}", self.port, self.token)
    }

    /// Whether the request's host name is a name of this machine. Without this check, a page under a foreign name could
    /// use this server.
    pub fn is_our_host(&self, host: Option<&str>) -> bool {
        let ours = |name: &str| host == Some(format!("{name}:{}", self.port).as_str());
        ours("127.0.0.1") || ours("localhost")
    }

    /// Whether the request comes from this server's page. A browser sends the origin of the page when it opens a
    /// socket.
    pub fn is_our_origin(&self, origin: Option<&str>) -> bool {
        self.is_our_host(origin.and_then(|origin| origin.strip_prefix("http://")))
    }

    /// Compares the token. The comparison takes the same time for every token, so the time says nothing about the
    /// token.
    pub fn is_our_token(&self, token: Option<&str>) -> bool {
        let token = token.unwrap_or_default().as_bytes();
        let differs = self.token.bytes().enumerate().fold(0, |differs, (n, byte)| {
            differs | (token.get(n).copied().unwrap_or_default() ^ byte)
        });
        token.len() == self.token.len() && differs == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_our_own_page_with_the_token_is_ours() {
        let access = Access::new([0xAB; 16], 8123);
        let token = "ab".repeat(16);
        assert_eq!(access.address(), format!("http://127.0.0.1:8123/?token={token}"));
        assert!(access.is_our_token(Some(&token)));
        let near = format!("{}aa", &token[..30]);
        for wrong in [None, Some(""), Some("ab"), Some(near.as_str()), Some(&format!("{token}a"))] {
            assert!(!access.is_our_token(wrong), "{wrong:?}");
        }
        for host in ["127.0.0.1:8123", "localhost:8123"] {
            assert!(access.is_our_host(Some(host)));
            assert!(access.is_our_origin(Some(&format!("http://{host}"))));
        }
        for host in
            ["", "127.0.0.1", "127.0.0.1:81", "evil.example:8123", "localhost:8123.evil.example"]
        {
            assert!(!access.is_our_host(Some(host)), "{host}");
            assert!(!access.is_our_origin(Some(&format!("http://{host}"))), "{host}");
        }
        for origin in ["null", "https://127.0.0.1:8123", "file://", "127.0.0.1:8123"] {
            assert!(!access.is_our_origin(Some(origin)), "{origin}");
        }
        assert!(!access.is_our_host(None) && !access.is_our_origin(None));
    }
}
