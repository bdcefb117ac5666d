//! The web page of a live session: shows the view of the camera, the target pose of the board, and the result in a
//! browser.
//!
//! It is served on this computer only (127.0.0.1) unless another address is given. Requests must name this server as
//! their host, to prevent DNS rebinding. Data and commands need a token that is new in every run. The token is after
//! the `#` of the address, which browsers do not send ([`gate`]).
//!
//! Publishing a state replaces the previous one and never blocks; a page requests the newest state after drawing the
//! last one. A slow or frozen page therefore receives fewer states, and no backlog builds up.

mod assets;
pub mod gate;
mod server;
#[cfg(test)]
mod tests;
pub mod view;

use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use evcal_files::remedies;
use hyper::body::Bytes;
use serde::Serialize;
use tokio::sync::{oneshot, watch};

use self::gate::{Gate, Secret};

/// First port that is tried, and number of further ports.
const PORT: u16 = 8346;
const MORE_PORTS: u16 = 10;

/// A state in its transmitted form: length of the JSON and number of the state (each 4 bytes, little-endian), the JSON,
/// and one byte per pixel of the sensor and of the frame.
#[derive(Clone, Debug, Default)]
struct State {
    number: u32,
    body: Bytes,
}

/// State shared by the server and the publishers.
struct Shared {
    gate: Gate,
    newest: watch::Sender<State>,
    /// The report, once it is finished.
    report: Mutex<Option<Bytes>>,
    /// Path of the report on the server; it cannot be guessed.
    report_path: String,
    /// Path prefix of the result files; it cannot be guessed.
    files_path: String,
    /// The result files.
    files: Mutex<Vec<ServedFile>>,
    /// `true` if the page shows frames.
    frames: AtomicBool,
    finish: AtomicBool,
    next: Mutex<Option<Next>>,
    /// Time of the latest request of a page.
    asked: Mutex<Option<Instant>>,
}

/// A result file.
#[derive(Clone, Debug)]
struct ServedFile {
    /// Its path on the server.
    path: String,
    /// Its path on the disk.
    file: PathBuf,
}

/// The user's choice after a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// End the program.
    Close,
    /// Replace the recordings so far by another one.
    Again,
    /// Add another recording to those so far.
    Add,
}

/// Reason why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// None of the ports can be used.
    #[error("no page: ports {first} to {last} of {address} cannot be used: {error}")]
    Port {
        /// The address.
        address: IpAddr,
        /// The first that was tried.
        first: u16,
        /// The last.
        last: u16,
        /// Error of the operating system.
        error: io::Error,
    },
    /// The operating system provided no thread or no random numbers.
    #[error("the page cannot be served: {0}")]
    System(io::Error),
}

remedies! { PageError, say;
    Self::Port { .. } => "choose another with {}, or run without a page with {}", say.port?, say.no_page?;
    Self::System(_) => "add {} to run without a page", say.no_page?;
}

/// A page that is being served until this value is dropped.
pub struct Page {
    shared: Arc<Shared>,
    address: SocketAddr,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Page {
    /// Serves a page at `address` of this computer, on `port` (0: any free one) or on the first free port from 8346 on.
    ///
    /// # Errors
    /// [`PageError`].
    pub fn start(address: IpAddr, port: Option<u16>) -> Result<Self, PageError> {
        let listener = listen(address, port)?;
        let address = listener.local_addr().map_err(PageError::System)?;
        let (token, report, files) = (Secret::new()?, Secret::new()?, Secret::new()?);
        let shared = Arc::new(Shared {
            gate: Gate::new(address, token),
            newest: watch::Sender::new(State::default()),
            report: Mutex::default(),
            report_path: format!("/report/{report}"),
            files_path: format!("/files/{files}"),
            files: Mutex::default(),
            frames: AtomicBool::new(false),
            finish: AtomicBool::new(false),
            next: Mutex::default(),
            asked: Mutex::default(),
        });
        let (end, ended) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(PageError::System)?;
        listener.set_nonblocking(true).map_err(PageError::System)?;
        let of_thread = Arc::clone(&shared);
        let thread = thread::Builder::new()
            .name("page".to_owned())
            .spawn(move || runtime.block_on(server::serve(listener, of_thread, ended)))
            .map_err(PageError::System)?;
        Ok(Self { shared, address, end: Some(end), thread: Some(thread) })
    }

    /// Returns the address of the page, with the token.
    pub fn url(&self) -> String {
        let address = match self.address.ip().is_unspecified() {
            true => SocketAddr::new(outward(self.address.ip()).unwrap_or(self.address.ip()), self.address.port()),
            false => self.address,
        };
        format!("http://{address}/#{}", self.shared.gate.token())
    }

    /// Returns a publisher of states, for another thread.
    pub fn publisher(&self) -> Publisher {
        Publisher(Arc::clone(&self.shared))
    }

    /// Makes a finished report available, and returns its path on this server.
    pub fn set_report(&self, html: String) -> String {
        *self.shared.report.lock().unwrap_or_else(PoisonError::into_inner) = Some(html.into());
        self.shared.report_path.clone()
    }

    /// Makes the files `names` in the folder of the results available, and no others. Returns their paths on this
    /// server, in the same order.
    pub fn set_files(&self, folder: &Path, names: &[String]) -> Vec<String> {
        let served: Vec<ServedFile> = names
            .iter()
            .map(|name| ServedFile { path: format!("{}/{name}", self.shared.files_path), file: folder.join(name) })
            .collect();
        let paths = served.iter().map(|served| served.path.clone()).collect();
        *self.shared.files.lock().unwrap_or_else(PoisonError::into_inner) = served;
        paths
    }

    /// Returns `true` if the user asked to end the recording.
    pub fn is_finish_asked(&self) -> bool {
        self.shared.finish.load(Ordering::Relaxed)
    }

    /// Returns the user's choice after the recording, once.
    pub fn take_next(&self) -> Option<Next> {
        self.shared.next.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Forgets the user's earlier requests, at the start of a recording.
    pub fn begin(&self) {
        self.shared.finish.store(false, Ordering::Relaxed);
        self.take_next();
    }

    /// Returns `true` if a page sent a request within the last `time`.
    pub fn is_watched(&self, time: Duration) -> bool {
        let asked = *self.shared.asked.lock().unwrap_or_else(PoisonError::into_inner);
        asked.is_some_and(|asked| asked.elapsed() < time)
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // This fails if the server has already ended.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take() {
            // Errors of the server no longer matter.
            let _ = thread.join();
        }
    }
}

/// Publishes states to the pages.
#[derive(Clone)]
pub struct Publisher(Arc<Shared>);

impl Publisher {
    /// Returns `true` if the page shows frames.
    pub fn are_frames_wanted(&self) -> bool {
        self.0.frames.load(Ordering::Relaxed)
    }

    /// Publishes a state; `pixels` are the pixels of an [`EventPicture`](crate::picture::EventPicture), `frame` those
    /// of a frame. Never waits for a page.
    pub fn publish(&self, head: &impl Serialize, pixels: &[u8], frame: &[u8]) {
        // The content of the view can always be written as JSON.
        let Ok(head) = serde_json::to_vec(head) else { return };
        self.0.newest.send_modify(|state| {
            let number = state.number.wrapping_add(1).max(1);
            let mut body = Vec::with_capacity(8 + head.len() + pixels.len() + frame.len());
            body.extend_from_slice(&(head.len() as u32).to_le_bytes());
            body.extend_from_slice(&number.to_le_bytes());
            body.extend_from_slice(&head);
            body.extend_from_slice(pixels);
            body.extend_from_slice(frame);
            *state = State { number, body: body.into() };
        });
    }
}

/// Returns the address from which this computer would send to other networks, under which others can reach it. Nothing
/// is sent.
fn outward(unspecified: IpAddr) -> Option<IpAddr> {
    let socket = UdpSocket::bind((unspecified, 0)).ok()?;
    // Addresses for documentation (RFC 5737, RFC 3849), which are not routed.
    let elsewhere = if unspecified.is_ipv4() { "192.0.2.1:9" } else { "[2001:db8::1]:9" };
    socket.connect(elsewhere).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

/// Listens on `port`, or on the first free one of the default ports.
fn listen(address: IpAddr, port: Option<u16>) -> Result<TcpListener, PageError> {
    let (first, last) = port.map_or((PORT, PORT + MORE_PORTS), |port| (port, port));
    let mut failure = None;
    for port in first..=last {
        match TcpListener::bind((address, port)) {
            Ok(listener) => return Ok(listener),
            Err(error) => failure = Some(error),
        }
    }
    let error = failure.unwrap_or_else(|| io::ErrorKind::AddrInUse.into());
    Err(PageError::Port { address, first, last, error })
}
