//! The HTTP server, with limits on connections, request heads and waiting times.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::ffi::OsStr;
use std::fs;
use std::net::TcpListener;
use std::path::PathBuf;
use std::pin::pin;
use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};
use tokio::task::{AbortHandle, spawn_blocking};
use tokio::time::{sleep, timeout};

use super::assets::ASSETS;
use super::gate::Need;
use super::{Next, Shared};

/// Largest number of simultaneous connections that have sent the token; further ones are rejected.
const MOST_KNOWN: usize = 16;
/// Largest number of simultaneous connections that have not sent the token. The oldest is closed for a new one, so that
/// incomplete requests cannot block the server.
const MOST_UNKNOWN: usize = 64;
/// Largest size of a request's head in bytes.
const LONGEST_HEAD: usize = 16 * 1024;
/// Longest wait for the head of a request.
const HEAD_PATIENCE: Duration = Duration::from_secs(5);
/// Time that a request waits for a new state before the page must ask again.
const STATE_PATIENCE: Duration = Duration::from_secs(1);
/// Time after which a connection is closed. Otherwise connections whose clients do not read would accumulate; a browser
/// opens a new connection.
const CONNECTION_AGE: Duration = Duration::from_secs(60);
/// Longest time for closing a connection.
const CLOSING: Duration = Duration::from_secs(5);
/// Pause after a connection could not be accepted.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Content security policy of the page: it may load only its own files.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; \
     frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
/// Content security policy of the report: it may load its own pictures and style, and run no script.
const REPORT_POLICY: &str =
    "sandbox allow-popups; default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'self'";

const RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");
const OPENER_POLICY: HeaderName = HeaderName::from_static("cross-origin-opener-policy");

type Answer = Response<Full<Bytes>>;

/// Serves until `ended` is signalled.
pub async fn serve(listener: TcpListener, shared: Arc<Shared>, ended: oneshot::Receiver<()>) {
    let accepting = tokio::spawn(accept(listener, shared));
    // A dropped sender also signals the end.
    let _ = ended.await;
    accepting.abort();
}

async fn accept(listener: TcpListener, shared: Arc<Shared>) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let places = Arc::new(Semaphore::new(MOST_KNOWN));
    let mut unknown: VecDeque<(AbortHandle, Arc<OnceLock<OwnedSemaphorePermit>>)> = VecDeque::new();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(ACCEPT_PAUSE).await;
            continue;
        };
        unknown.retain(|(task, known)| !task.is_finished() && known.get().is_none());
        if unknown.len() >= MOST_UNKNOWN
            && let Some((oldest, _)) = unknown.pop_front()
        {
            oldest.abort();
        }
        // The permit that this connection acquires when it sends the token.
        let known: Arc<OnceLock<OwnedSemaphorePermit>> = Arc::default();
        let (shared, places, own) = (Arc::clone(&shared), Arc::clone(&places), Arc::clone(&known));
        let task = tokio::spawn(async move {
            let answer = service_fn(|request| {
                let (shared, places, known) = (Arc::clone(&shared), Arc::clone(&places), Arc::clone(&own));
                async move { Ok::<_, Infallible>(answer_known(&shared, &request, &places, &known).await) }
            });
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEAD_PATIENCE)
                .max_buf_size(LONGEST_HEAD)
                .serve_connection(TokioIo::new(stream), answer);
            let mut connection = pin!(connection);
            // Errors of a connection are caused by the other side and are not reported.
            if timeout(CONNECTION_AGE, connection.as_mut()).await.is_err() {
                connection.as_mut().graceful_shutdown();
                let _ = timeout(CLOSING, connection).await;
            }
        });
        unknown.push_back((task.abort_handle(), known));
    }
}

/// Answers a request; a connection that sends the token for the first time acquires a permit.
async fn answer_known(
    shared: &Shared,
    request: &Request<Incoming>,
    places: &Arc<Semaphore>,
    known: &OnceLock<OwnedSemaphorePermit>,
) -> Answer {
    if known.get().is_none() && shared.gate.has_token(request.headers()) {
        match Arc::clone(places).try_acquire_owned() {
            // The permit was absent just before, and a connection has one request at a time.
            Ok(place) => _ = known.set(place),
            Err(_) => return plain(StatusCode::SERVICE_UNAVAILABLE),
        }
    }
    answer(shared, request).await
}

async fn answer(shared: &Shared, request: &Request<Incoming>) -> Answer {
    let (method, uri, headers) = (request.method(), request.uri(), request.headers());
    let path = uri.path();
    let asset = ASSETS.iter().find(|asset| asset.path == path);
    let is_report = path == shared.report_path;
    let file = file_at(shared, path);
    let need = if asset.is_some() || is_report || file.is_some() { Need::Host } else { Need::Token };
    if let Err(status) = shared.gate.check(method, uri, headers, need) {
        return plain(status);
    }
    if let (&Method::GET, Some(asset)) = (method, asset) {
        return with(StatusCode::OK, asset.kind, PAGE_POLICY, Bytes::from_static(asset.content.as_bytes()));
    }
    if let (&Method::GET, Some(file)) = (method, file) {
        return content(file).await;
    }
    match (method, path) {
        (&Method::GET, _) if is_report => report(shared),
        (&Method::GET, "/live") => state(shared, uri.query()).await,
        (&Method::POST, "/finish") => {
            shared.finish.store(true, Ordering::Relaxed);
            plain(StatusCode::NO_CONTENT)
        }
        (&Method::POST, "/frames") => {
            shared.frames.fetch_xor(true, Ordering::Relaxed);
            plain(StatusCode::NO_CONTENT)
        }
        (&Method::POST, "/close") => set_next(shared, Next::Close),
        (&Method::POST, "/again") => set_next(shared, Next::Again),
        (&Method::POST, "/add") => set_next(shared, Next::Add),
        (&Method::GET | &Method::POST, _) => plain(StatusCode::NOT_FOUND),
        _ => plain(StatusCode::METHOD_NOT_ALLOWED),
    }
}

fn set_next(shared: &Shared, next: Next) -> Answer {
    *shared.next.lock().unwrap_or_else(PoisonError::into_inner) = Some(next);
    plain(StatusCode::NO_CONTENT)
}

/// Returns the result file at this path, if it is one of the published files.
fn file_at(shared: &Shared, path: &str) -> Option<PathBuf> {
    let files = shared.files.lock().unwrap_or_else(PoisonError::into_inner);
    files.iter().find(|served| served.path == path).map(|served| served.file.clone())
}

/// Returns the current content of a result file.
async fn content(file: PathBuf) -> Answer {
    let kind = match file.extension().and_then(OsStr::to_str) {
        Some("png") => "image/png",
        Some("html") => "text/html; charset=utf-8",
        _ => "text/plain; charset=utf-8",
    };
    match spawn_blocking(move || fs::read(file)).await {
        Ok(Ok(content)) => with(StatusCode::OK, kind, REPORT_POLICY, content.into()),
        _ => plain(StatusCode::NOT_FOUND),
    }
}

fn report(shared: &Shared) -> Answer {
    let report = shared.report.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match report {
        Some(report) => with(StatusCode::OK, "text/html; charset=utf-8", REPORT_POLICY, report),
        None => plain(StatusCode::NOT_FOUND),
    }
}

/// Returns the newest state as soon as it is newer than the page's; 204 if nothing changes for a while.
async fn state(shared: &Shared, query: Option<&str>) -> Answer {
    *shared.asked.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    let after = query.and_then(|query| query.strip_prefix("after=")).and_then(|after| after.parse::<u32>().ok());
    let Some(after) = after else { return plain(StatusCode::BAD_REQUEST) };
    let mut newest = shared.newest.subscribe();
    let body = match timeout(STATE_PATIENCE, newest.wait_for(|state| state.number > after)).await {
        Ok(Ok(state)) => Some(state.body.clone()),
        _ => None,
    };
    match body {
        Some(body) => with(StatusCode::OK, "application/octet-stream", PAGE_POLICY, body),
        None => plain(StatusCode::NO_CONTENT),
    }
}

/// Returns an answer that contains only a status.
fn plain(status: StatusCode) -> Answer {
    let text = match status {
        StatusCode::NO_CONTENT => "",
        _ => status.canonical_reason().unwrap_or_default(),
    };
    with(status, "text/plain; charset=utf-8", PAGE_POLICY, Bytes::from_static(text.as_bytes()))
}

fn with(status: StatusCode, kind: &'static str, policy: &'static str, body: Bytes) -> Answer {
    let mut answer = Response::new(Full::new(body));
    *answer.status_mut() = status;
    for (name, value) in [
        (CONTENT_TYPE, kind),
        (CONTENT_SECURITY_POLICY, policy),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, "no-store"),
        (RESOURCE_POLICY, "same-origin"),
        (OPENER_POLICY, "same-origin"),
    ] {
        answer.headers_mut().insert(name, hyper::header::HeaderValue::from_static(value));
    }
    answer
}
