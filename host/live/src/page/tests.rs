//! Tests of the server with real requests over TCP.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::assets::ASSETS;
use super::*;

fn token(page: &Page) -> String {
    page.url().split_once('#').unwrap().1.to_owned()
}

fn host(page: &Page) -> String {
    page.address.to_string()
}

/// Sends a head; returns the status and the whole answer.
fn ask(page: &Page, request: &str, headers: &[(&str, &str)]) -> (u16, Vec<u8>) {
    let lines: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let mut stream = TcpStream::connect(page.address).unwrap();
    write!(stream, "{request} HTTP/1.1\r\nConnection: close\r\n{lines}\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let status = String::from_utf8_lossy(answer.get(9..12).unwrap_or_default()).parse().unwrap_or(0);
    (status, answer)
}

fn status(page: &Page, request: &str, headers: &[(&str, &str)]) -> u16 {
    ask(page, request, headers).0
}

fn page() -> Page {
    Page::start(Ipv4Addr::LOCALHOST.into(), Some(0)).unwrap()
}

/// A request with a foreign host name (DNS rebinding) receives no data, even with the token.
#[test]
fn a_foreign_host_is_refused() {
    let page = page();
    page.publisher().publish(&"secret", &[], &[]);
    let (token, own) = (token(&page), host(&page));
    let port = page.address.port();
    for foreign in ["evil.example", "127.0.0.1", "127.0.0.1:1", &format!("evil.example:{port}"), ""] {
        for request in ["GET /", "GET /live?after=0", "POST /finish", "GET /report/x"] {
            let (status, answer) = ask(&page, request, &[("Host", foreign), ("X-Evcal-Token", &token)]);
            assert_eq!(status, 421, "{request} {foreign}");
            assert!(!String::from_utf8_lossy(&answer).contains("secret"));
        }
    }
    assert_eq!(status(&page, "GET /", &[]), 421);
    assert_eq!(status(&page, "GET /", &[("Host", &own), ("Host", "evil.example")]), 421);
    assert_eq!(status(&page, "GET http://evil.example/", &[("Host", &own)]), 421);
    assert_eq!(status(&page, "GET /", &[("Host", &own)]), 200);
    assert_eq!(status(&page, "GET /", &[("Host", &format!("localhost:{port}"))]), 200);
    assert!(!page.is_finish_asked());
}

#[test]
fn data_and_commands_need_the_token() {
    let page = page();
    page.publisher().publish(&"secret", &[7, 8], &[]);
    let (token, own) = (token(&page), host(&page));
    for request in [
        "GET /live?after=0",
        "POST /finish",
        "POST /close",
        "POST /again",
        "POST /add",
        "GET /report/0",
        "GET /nothing",
        "PUT /",
    ] {
        for wrong in ["", "0", &token[1..], &token.replace(|letter: char| letter.is_ascii_digit(), "a")] {
            assert_eq!(status(&page, request, &[("Host", &own), ("X-Evcal-Token", wrong)]), 403, "{request} {wrong}");
        }
        assert_eq!(status(&page, request, &[("Host", &own)]), 403, "{request}");
    }
    assert!(!page.is_finish_asked() && page.take_next().is_none() && !page.is_watched(Duration::MAX));
    let good = [("Host", own.as_str()), ("X-Evcal-Token", token.as_str())];
    let (status, answer) = ask(&page, "GET /live?after=0", &good);
    assert_eq!(status, 200);
    assert!(answer.ends_with(b"\x08\0\0\0\x01\0\0\0\"secret\"\x07\x08"), "{}", String::from_utf8_lossy(&answer));
    assert!(page.is_watched(Duration::MAX));
    assert_eq!(ask(&page, "GET /live?after=1", &good).0, 204, "nothing new");
    assert_eq!(ask(&page, "GET /live?after=x", &good).0, 400);
    assert_eq!(ask(&page, "GET /nothing", &good).0, 404);
    assert_eq!(ask(&page, "PUT /live", &good).0, 405);
    assert_eq!(ask(&page, "POST /finish", &good).0, 204);
    assert!(page.is_finish_asked() && page.take_next().is_none());
    for (command, next) in [("close", Next::Close), ("again", Next::Again), ("add", Next::Add)] {
        assert_eq!(ask(&page, &format!("POST /{command}"), &good).0, 204);
        assert_eq!((page.take_next(), page.take_next()), (Some(next), None));
    }
    page.begin();
    assert!(!page.is_finish_asked());
}

#[test]
fn commands_from_another_site_are_refused() {
    let page = page();
    let (token, own) = (token(&page), host(&page));
    let with =
        |name, value: &str| status(&page, "POST /finish", &[("Host", &own), ("X-Evcal-Token", &token), (name, value)]);
    for (name, value) in [
        ("Sec-Fetch-Site", "cross-site"),
        ("Sec-Fetch-Site", "same-site"),
        ("Origin", "http://evil.example"),
        ("Origin", "null"),
        ("Origin", "http://127.0.0.1:1"),
    ] {
        assert_eq!(with(name, value), 403, "{name}: {value}");
    }
    assert!(!page.is_finish_asked());
    // The preflight request of a browser for a foreign header is not granted.
    let (status, answer) = ask(&page, "OPTIONS /finish", &[("Host", &own), ("Origin", "http://evil.example")]);
    assert_eq!(status, 403);
    assert!(!String::from_utf8_lossy(&answer).to_lowercase().contains("access-control"));
    assert_eq!(with("Origin", &format!("http://{own}")), 204);
    assert!(page.is_finish_asked());
}

#[test]
fn the_path_of_the_report_cannot_be_guessed() {
    let page = page();
    let own = host(&page);
    let path = page.shared.report_path.clone();
    let get = format!("GET {path}");
    assert_eq!(status(&page, &get, &[("Host", &own)]), 404);
    assert_eq!(page.set_report("<p>good</p>".to_owned()), path);
    let (status_of_report, answer) = ask(&page, &get, &[("Host", &own)]);
    let answer = String::from_utf8_lossy(&answer).to_lowercase();
    assert_eq!(status_of_report, 200);
    assert!(answer.ends_with("<p>good</p>") && answer.contains("content-security-policy: sandbox"));
    assert_eq!(status(&page, &format!("{get}0"), &[("Host", &own)]), 403);
    assert_ne!(page.shared.report_path, self::page().shared.report_path);
}

/// Only published files in the folder of the results are served, on a path that cannot be guessed.
#[test]
fn only_named_files_are_served() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["camera.yaml", "secret.txt", "example.png"] {
        std::fs::write(folder.path().join(name), name).unwrap();
    }
    let page = page();
    let own = host(&page);
    let names = ["camera.yaml", "example.png", "gone.csv"].map(str::to_owned);
    let paths = page.set_files(folder.path(), &names);
    let get = |path: &str| ask(&page, &format!("GET {path}"), &[("Host", &own)]);
    for (path, content, kind) in [(&paths[0], "camera.yaml", "text/plain"), (&paths[1], "example.png", "image/png")] {
        let (status, answer) = get(path);
        let answer = String::from_utf8(answer).unwrap().to_lowercase();
        assert!(status == 200 && answer.ends_with(content) && answer.contains(kind), "{answer}");
        assert!(answer.contains("content-security-policy: sandbox") && answer.contains("nosniff"), "{answer}");
    }
    assert_eq!(get(&paths[2]).0, 404, "it is gone");
    let base = paths[0].strip_suffix("/camera.yaml").unwrap();
    for other in ["secret.txt", "../secret.txt", "..%2fsecret.txt", "", "camera.yaml/", "./camera.yaml"] {
        assert_eq!(get(&format!("{base}/{other}")).0, 403, "{other}");
    }
    assert_eq!(get("/files/0/camera.yaml").0, 403);
    assert_eq!(ask(&page, &format!("GET {}", paths[0]), &[("Host", "evil.example")]).0, 421);
    assert_eq!(ask(&page, &format!("POST {}", paths[0]), &[("Host", &own)]).0, 403, "a command needs the token");
}

#[test]
fn frames_are_sent_on_request() {
    let page = page();
    let (token, own) = (token(&page), host(&page));
    let publisher = page.publisher();
    assert!(!publisher.are_frames_wanted());
    assert_eq!(status(&page, "POST /frames", &[("Host", &own)]), 403);
    assert!(!publisher.are_frames_wanted());
    let good = [("Host", own.as_str()), ("X-Evcal-Token", token.as_str())];
    for wanted in [true, false, true] {
        assert_eq!(status(&page, "POST /frames", &good), 204);
        assert_eq!(publisher.are_frames_wanted(), wanted);
    }
    publisher.publish(&1, &[7, 8], &[9]);
    assert!(ask(&page, "GET /live?after=0", &good).1.ends_with(b"1\x07\x08\x09"));
}

/// A page for other computers answers requests for numeric addresses and `localhost`, but not for other names.
#[test]
fn a_page_for_other_computers_accepts_only_addresses_as_host() {
    let page = Page::start(Ipv4Addr::UNSPECIFIED.into(), Some(0)).unwrap();
    page.publisher().publish(&"secret", &[], &[]);
    let (token, port) = (token(&page), page.address.port());
    let ask = |host: &str, token: &str| {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        write!(
            stream,
            "GET /live?after=0 HTTP/1.1\r\nConnection: close\r\nHost: {host}\r\nX-Evcal-Token: {token}\r\n\r\n"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer.get(9..12).unwrap().parse::<u16>().unwrap()
    };
    for own in ["127.0.0.1", "192.0.2.7", "localhost"] {
        assert_eq!(ask(&format!("{own}:{port}"), &token), 200, "{own}");
        assert_eq!(ask(&format!("{own}:{port}"), ""), 403, "{own}");
    }
    let foreign = format!("evil.example:{port}");
    for foreign in [foreign.as_str(), "192.0.2.7:1", "192.0.2.7", ""] {
        assert_eq!(ask(foreign, &token), 421, "{foreign}");
    }
    assert!(!page.url().contains("0.0.0.0") || outward(Ipv4Addr::UNSPECIFIED.into()).is_none(), "{}", page.url());
    // A single address accepts only itself.
    let gate = Gate::new("192.0.2.7:8346".parse().unwrap(), Secret::new().unwrap());
    let check = |host: &'static str| {
        let mut headers = hyper::HeaderMap::new();
        headers.insert(hyper::header::HOST, host.parse().unwrap());
        gate.check(&hyper::Method::GET, &"/".parse().unwrap(), &headers, gate::Need::Host).is_ok()
    };
    assert!(
        check("192.0.2.7:8346") && !check("127.0.0.1:8346") && !check("localhost:8346") && !check("192.0.2.8:8346")
    );
}

#[test]
fn the_page_loads_nothing_from_other_sites() {
    let page = page();
    let own = host(&page);
    for asset in ASSETS {
        let (status, answer) = ask(&page, &format!("GET {}", asset.path), &[("Host", &own)]);
        let answer = String::from_utf8(answer).unwrap();
        assert_eq!(status, 200, "{}", asset.path);
        assert!(answer.ends_with(asset.content));
        let head = answer.to_lowercase();
        for line in ["default-src 'none'", "frame-ancestors 'none'", "nosniff", "no-referrer", "no-store"] {
            assert!(head.contains(line), "{} {line}", asset.path);
        }
        let foreign = asset.content.replace("http://www.w3.org/2000/svg", "");
        assert!(!foreign.contains("http://") && !foreign.contains("https://"), "{}", asset.path);
    }
    let bytes: usize = ASSETS.iter().map(|asset| asset.content.len()).sum();
    assert!(bytes < 150_000, "{bytes}");
}

#[test]
fn the_page_listens_only_on_this_computer() {
    assert!(page().address.ip().is_loopback());
    let taken = page();
    let error = Page::start(Ipv4Addr::LOCALHOST.into(), Some(taken.address.port())).err().unwrap();
    assert!(matches!(error, PageError::Port { .. }), "{error}");
}

/// Connections that send a byte now and then, or never read, neither block the publisher nor build up a backlog.
#[test]
fn slow_clients_do_not_delay_the_publisher() {
    let page = page();
    let (token, own) = (token(&page), host(&page));
    let publisher = page.publisher();
    let slow: Vec<TcpStream> = (0..16)
        .map(|_| {
            let mut stream = TcpStream::connect(page.address).unwrap();
            stream.write_all(b"G").unwrap();
            stream
        })
        .collect();
    let pixels = vec![1; 346 * 260];
    for number in 0..200 {
        publisher.publish(&number, &pixels, &[]);
    }
    let newest = page.shared.newest.borrow().clone();
    assert_eq!(newest.number, 200);
    drop(slow);
    // The server notices after some time that the clients are gone.
    let good = [("Host", own.as_str()), ("X-Evcal-Token", token.as_str())];
    let answer = (0..1000).find_map(|_| {
        let (status, answer) = ask_if_possible(&page, &good)?;
        (status == 200).then_some(answer)
    });
    assert!(answer.unwrap().ends_with(&newest.body), "only the newest is sent");
}

/// Many incomplete heads must not block other clients.
#[test]
fn incomplete_heads_do_not_block_other_clients() {
    let page = page();
    page.publisher().publish(&1, &[], &[]);
    let own = host(&page);
    let stalled: Vec<TcpStream> = (0..200)
        .map(|_| {
            let mut stream = TcpStream::connect(page.address).unwrap();
            stream.write_all(b"GET / HT").unwrap();
            stream
        })
        .collect();
    for _ in 0..20 {
        assert_eq!(status(&page, "GET /", &[("Host", &own)]), 200);
        let with_token = [("Host", own.as_str()), ("X-Evcal-Token", &token(&page))];
        assert_eq!(ask_if_possible(&page, &with_token).map(|(status, _)| status), Some(200));
    }
    drop(stalled);
}

fn ask_if_possible(page: &Page, headers: &[(&str, &str)]) -> Option<(u16, Vec<u8>)> {
    let lines: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let mut stream = TcpStream::connect(page.address).ok()?;
    let request = format!("GET /live?after=0 HTTP/1.1\r\nConnection: close\r\n{lines}\r\n");
    let mut answer = Vec::new();
    let read = stream.write_all(request.as_bytes()).and_then(|()| stream.read_to_end(&mut answer));
    if read.is_err() {
        thread::sleep(Duration::from_millis(10));
        return None;
    }
    Some((String::from_utf8_lossy(answer.get(9..12)?).parse().ok()?, answer))
}

#[test]
fn malformed_heads_do_not_end_the_server() {
    let page = page();
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let whole =
        format!("GET /live?after=0 HTTP/1.1\r\nHost: {}\r\nX-Evcal-Token: {}\r\n\r\n", host(&page), token(&page));
    for round in 0..200 {
        let mut head = whole.clone().into_bytes();
        for _ in 0..1 + round % 5 {
            let place = random.next_u32() as usize % head.len();
            head[place] = random.next_u32() as u8;
        }
        head.truncate(random.next_u32() as usize % (head.len() + 1));
        let mut stream = TcpStream::connect(page.address).unwrap();
        // The connection may already be closed.
        let _ = stream.write_all(&head);
    }
    let mut long = TcpStream::connect(page.address).unwrap();
    let _ = long.write_all(&vec![b'a'; 100_000]);
    drop(long);
    let own = host(&page);
    let headers = [("Host", own.as_str()), ("X-Evcal-Token", &token(&page))];
    page.publisher().publish(&1, &[], &[]);
    assert!((0..1000).find_map(|_| ask_if_possible(&page, &headers)).is_some_and(|(status, _)| status == 200));
}
