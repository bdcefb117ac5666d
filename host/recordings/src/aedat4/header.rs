//! The header of an AEDAT4 file: compression, streams, and the position of the table of packets.
//!
//! ```text
//! "#!AER-DAT4.0\r\n"
//! u32 size, FlatBuffer "IOHE" { compression: i32, dataTablePosition: i64 = -1, infoNode: string }
//! ```
//! `infoNode` is XML: below the node `outInfo` one node per stream, named by its number, with the attributes
//! `typeIdentifier` (EVTS, FRME, IMUS, TRIG), `originalOutputName` and `originalModuleName` (the module or program that
//! recorded it), and a node `info` with `sizeX`, `sizeY` and `source` (the camera). evutils writes no identifier, calls
//! the node `info` instead of `outInfo`, and has the size in the node of the stream.

use super::flatbuffer::{self, Malformed};

/// Name that evcal writes for a camera without one.
pub const UNKNOWN_CAMERA: &str = "unknown camera";

/// First bytes of every AEDAT4 file.
pub const MAGIC: &[u8; 14] = b"#!AER-DAT4.0\r\n";

/// Compression of packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Compression {
    /// No compression.
    None,
    /// Each packet is an LZ4 frame.
    Lz4,
    /// Each packet is a Zstandard frame.
    Zstd,
}

/// One stream of packets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stream {
    /// Number of the stream in its packets.
    pub id: i32,
    /// Name of the recorded output, for example `events`.
    pub name: String,
    /// Content of its packets: EVTS events, FRME frames, IMUS IMU samples, TRIG triggers.
    pub type_identifier: String,
    /// Width and height in pixels, if given.
    pub size: Option<(i64, i64)>,
    /// Model and serial number of the camera.
    pub source: Option<String>,
    /// `true` if rows count from below, because jAER recorded the stream (`Aedat4FileOutputStream` of jAER 3 writes its
    /// own coordinates).
    pub rows_from_below: bool,
}

/// The header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Compression of packets.
    pub compression: Compression,
    /// Offset of the table of packets at the end of the file; `None` if the recording was not closed.
    pub table_position: Option<u64>,
    /// The streams, sorted by number.
    pub streams: Vec<Stream>,
}

/// Error while parsing a header.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum HeaderError {
    /// The FlatBuffer is invalid.
    #[error("the header cannot be read: {0}")]
    Malformed(&'static str),
    /// The number of the compression is unknown.
    #[error("the header states compression {0}; 0 to 4 are known")]
    Compression(i32),
    /// The description of the streams is not valid XML.
    #[error("the header's description of the streams is not valid XML: {0}")]
    Xml(#[from] roxmltree::Error),
    /// The description of the streams is missing.
    #[error("the header describes no streams (no node outInfo)")]
    NoStreams,
}

/// Parses the FlatBuffer of the header, without its size prefix.
///
/// # Errors
/// [`HeaderError`].
pub fn parse(bytes: &[u8]) -> Result<Header, HeaderError> {
    let parse = || {
        let root = flatbuffer::root_of_any(bytes, b"IOHE")?;
        Ok((root.i32(0, 0)?, root.i64(1, -1)?, root.string(2)?))
    };
    let (compression, table_position, information) = parse().map_err(|Malformed(what)| HeaderError::Malformed(what))?;
    let compression = match compression {
        0 => Compression::None,
        1 | 2 => Compression::Lz4,
        3 | 4 => Compression::Zstd,
        other => return Err(HeaderError::Compression(other)),
    };
    Ok(Header { compression, table_position: u64::try_from(table_position).ok(), streams: streams(information)? })
}

fn streams(information: &str) -> Result<Vec<Stream>, HeaderError> {
    let document = evcal_files::xml::parse(information)?;
    let is_named = |node: &roxmltree::Node, name| node.has_tag_name("node") && node.attribute("name") == Some(name);
    let outputs = document.descendants().find(|node| is_named(node, "outInfo"));
    let outputs = outputs.or_else(|| Some(document.root_element()).filter(|root| is_named(root, "info")));
    let outputs = outputs.ok_or(HeaderError::NoStreams)?;
    let mut streams: Vec<Stream> = outputs
        .children()
        .filter(|node| node.has_tag_name("node"))
        .filter_map(|node| {
            let id = node.attribute("name")?.parse().ok()?;
            let info = node.children().find(|child| child.attribute("name") == Some("info"));
            let of_info = |key| attribute(info.unwrap_or(node), key);
            Some(Stream {
                id,
                name: attribute(node, "originalOutputName").unwrap_or_default().to_owned(),
                type_identifier: attribute(node, "typeIdentifier").unwrap_or_default().to_owned(),
                size: of_info("sizeX")
                    .zip(of_info("sizeY"))
                    .and_then(|(x, y)| Some((x.parse().ok()?, y.parse().ok()?))),
                source: of_info("source").filter(|name| *name != UNKNOWN_CAMERA).map(str::to_owned),
                rows_from_below: attribute(node, "originalModuleName").is_some_and(is_jaer),
            })
        })
        .collect();
    streams.sort_by_key(|stream| stream.id);
    Ok(streams)
}

fn is_jaer(module: &str) -> bool {
    module.get(..4).is_some_and(|start| start.eq_ignore_ascii_case("jaer"))
}

/// Returns the text of the child `<attr key="KEY">`.
fn attribute<'a>(node: roxmltree::Node<'a, '_>, key: &str) -> Option<&'a str> {
    node.children()
        .find(|child| child.has_tag_name("attr") && child.attribute("key") == Some(key))
        .and_then(|child| child.text())
        .map(str::trim)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A header as evutils writes it: a table without identifier, and other nodes.
    #[test]
    fn a_header_of_evutils_is_read() {
        let xml = "<?xml version=\"1.0\" encoding=\"UTF-8\"?><node name=\"info\"><node name=\"0\"><attr \
                   key=\"typeIdentifier\" type=\"string\">EVTS</attr><attr key=\"sizeX\" type=\"int\">346</attr><attr \
                   key=\"sizeY\" type=\"int\">260</attr></node><node name=\"1\"><attr key=\"typeIdentifier\" \
                   type=\"string\">TRIG</attr></node></node>";
        let table = [16_u32, 0x0014_000a, 0x0008_0004, 0x0000_0010, 12, 0, u32::MAX, u32::MAX, 4, xml.len() as u32];
        let bytes: Vec<u8> = table.into_iter().flat_map(u32::to_le_bytes).chain(xml.bytes()).chain([0]).collect();
        let header = parse(&bytes).unwrap();
        assert_eq!((header.compression, header.table_position), (Compression::None, None));
        let streams: Vec<_> = header.streams.iter().map(|it| (it.id, it.type_identifier.as_str(), it.size)).collect();
        assert_eq!(streams, [(0, "EVTS", Some((346, 260))), (1, "TRIG", None)]);
        for cut in 0..bytes.len() - 1 {
            assert!(parse(&bytes[..cut]).is_err(), "{cut}");
        }
    }
}
