//! Who gets an answer.

use std::fmt;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use hyper::header::{HOST, HeaderMap, HeaderName, HeaderValue, ORIGIN};
use hyper::{Method, StatusCode, Uri};

use super::PageError;

/// The header with the token.
pub const TOKEN: HeaderName = HeaderName::from_static("x-evcal-token");
/// From where a browser says that a request comes.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// 128 random bits.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret([u8; 16]);

impl Secret {
    /// A new one.
    ///
    /// # Errors
    /// [`PageError::System`] when the system gives no random numbers.
    pub fn new() -> Result<Self, PageError> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| PageError::System(io::Error::other(error)))?;
        Ok(Self(bytes))
    }
}

impl fmt::Display for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Which names and which token open it.
pub struct Gate {
    address: SocketAddr,
    token: String,
}

/// What a request needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// The right host only: files without data, and paths that nobody can guess.
    Host,
    /// The token as well.
    Token,
}

impl Gate {
    /// The gate of a server that listens here.
    pub fn new(address: SocketAddr, token: Secret) -> Self {
        Self { address, token: token.to_string() }
    }

    /// Whether a host is this server: its address in numbers, or `localhost` where that leads here. A name would let a foreign one lead
    /// here; a server that listens to all addresses of this computer answers to each of them.
    fn is_own(&self, host: &str) -> bool {
        let (own, port) = (self.address.ip(), self.address.port());
        match in_numbers(host) {
            Some(host) => host.port() == port && (host.ip() == own || own.is_unspecified()),
            None => {
                let (name, given) = host.rsplit_once(':').unwrap_or((host, "80"));
                let is_here = own.is_loopback() || own.is_unspecified();
                is_here && name.eq_ignore_ascii_case("localhost") && given == port.to_string()
            }
        }
    }

    /// The token.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Whether a request may pass.
    ///
    /// # Errors
    /// 421 for a foreign host; 403 without the token, for a request that another site made, and for a command that no
    /// page of this server sent.
    pub fn check(&self, method: &Method, uri: &Uri, headers: &HeaderMap, need: Need) -> Result<(), StatusCode> {
        let is_own = |host: &str| self.is_own(host);
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts.next().and_then(|host| host.to_str().ok());
        let is_addressed = host.is_some_and(is_own) && hosts.next().is_none();
        if !is_addressed || uri.authority().is_some_and(|authority| !is_own(authority.as_str())) {
            return Err(StatusCode::MISDIRECTED_REQUEST);
        }
        let is_command = *method != Method::GET;
        if need == Need::Host && !is_command {
            return Ok(());
        }
        let is_foreign_origin = headers.get_all(ORIGIN).iter().any(|origin| {
            let origin = origin.to_str().ok().and_then(|origin| origin.strip_prefix("http://"));
            !origin.is_some_and(is_own)
        });
        let is_cross_site =
            headers.get_all(FETCH_SITE).iter().any(|site| !matches!(site.as_bytes(), b"same-origin" | b"none"));
        if is_foreign_origin || is_cross_site || !self.is_token(headers.get(TOKEN)) {
            return Err(StatusCode::FORBIDDEN);
        }
        Ok(())
    }

    /// Whether a request shows the token.
    pub fn has_token(&self, headers: &HeaderMap) -> bool {
        self.is_token(headers.get(TOKEN))
    }

    /// Compares in a time that does not tell how much of it is right.
    fn is_token(&self, given: Option<&HeaderValue>) -> bool {
        let Some(given) = given.map(HeaderValue::as_bytes) else { return false };
        let differing = given.iter().zip(self.token.as_bytes()).fold(0, |bits, (a, b)| bits | (a ^ b));
        given.len() == self.token.len() && differing == 0
    }
}

/// The address that a host states in numbers; browsers leave port 80 out.
fn in_numbers(host: &str) -> Option<SocketAddr> {
    let without_port = || {
        let bracketed = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
        match bracketed {
            Some(host) => host.parse::<Ipv6Addr>().map(IpAddr::V6),
            None => host.parse::<Ipv4Addr>().map(IpAddr::V4),
        }
    };
    host.parse().ok().or_else(|| Some(SocketAddr::new(without_port().ok()?, 80)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn browsers_leave_port_80_out() {
        let passes = |address: &str, host: &str, origin: &str| {
            let gate = Gate::new(address.parse().unwrap(), Secret([7; 16]));
            let headers = [(HOST, host), (ORIGIN, origin), (TOKEN, gate.token())];
            let headers: HeaderMap =
                headers.into_iter().map(|(name, value)| (name, HeaderValue::from_str(value).unwrap())).collect();
            gate.check(&Method::POST, &Uri::from_static("/end"), &headers, Need::Token)
        };
        for (address, host) in [("127.0.0.1:80", "127.0.0.1"), ("[::1]:80", "[::1]"), ("127.0.0.1:80", "localhost")] {
            let whole = format!("{host}:80");
            for (host, origin) in [(host, host), (whole.as_str(), host), (host, whole.as_str())] {
                assert_eq!(passes(address, host, &format!("http://{origin}")), Ok(()), "{host} {origin}");
            }
            let elsewhere = address.replace(":80", ":8080");
            assert_eq!(passes(&elsewhere, host, &format!("http://{host}")), Err(StatusCode::MISDIRECTED_REQUEST));
            let whole = format!("{host}:8080");
            assert_eq!(passes(&elsewhere, &whole, &format!("http://{host}")), Err(StatusCode::FORBIDDEN));
        }
        for foreign in ["127.0.0.2", "::1", "[::1", "[127.0.0.1]", "evil.example"] {
            let outcome = passes("127.0.0.1:80", foreign, "http://127.0.0.1");
            assert_eq!(outcome, Err(StatusCode::MISDIRECTED_REQUEST), "{foreign}");
        }
    }
}
