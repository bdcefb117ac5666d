//! Access control of the page.

use std::fmt;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use hyper::header::{HOST, HeaderMap, HeaderName, HeaderValue, ORIGIN};
use hyper::{Method, StatusCode, Uri};

use super::PageError;

/// The request header with the token.
pub const TOKEN: HeaderName = HeaderName::from_static("x-evcal-token");
/// Header in which a browser reports whether a request comes from a page of another site.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// 128 random bits.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret([u8; 16]);

impl Secret {
    /// Creates a random secret.
    ///
    /// # Errors
    /// [`PageError::System`] if the operating system provides no random numbers.
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

/// Access rules of a server: accepted hosts and the token.
pub struct Gate {
    address: SocketAddr,
    token: String,
}

/// Access requirement of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Only the correct host: for files without data, and paths that cannot be guessed.
    Host,
    /// The correct host and the token.
    Token,
}

impl Gate {
    /// Creates the access rules of a server that listens at `address`.
    pub fn new(address: SocketAddr, token: Secret) -> Self {
        Self { address, token: token.to_string() }
    }

    /// Returns `true` if `host` is this server: its numeric address, or `localhost` if it listens on the loopback
    /// address. A server that listens on all addresses accepts `localhost` and every numeric address with its port.
    /// Other names are rejected to prevent DNS rebinding.
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

    /// Returns the token.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Checks whether a request is allowed.
    ///
    /// # Errors
    /// 421 for another host. 403 for a request without the token or from a page of another origin, unless it only gets
    /// something that needs the host alone.
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

    /// Returns `true` if a request contains the token.
    pub fn has_token(&self, headers: &HeaderMap) -> bool {
        self.is_token(headers.get(TOKEN))
    }

    /// Compares in constant time, so that the time reveals nothing about the token.
    fn is_token(&self, given: Option<&HeaderValue>) -> bool {
        let Some(given) = given.map(HeaderValue::as_bytes) else { return false };
        let differing = given.iter().zip(self.token.as_bytes()).fold(0, |bits, (a, b)| bits | (a ^ b));
        given.len() == self.token.len() && differing == 0
    }
}

/// Returns the numeric address in a host; browsers omit port 80.
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
    fn port_80_may_be_omitted_from_host_and_origin() {
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
