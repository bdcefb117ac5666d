//! Loading of XML from other programs within bounds: the parser's time grows with the square of an element's attributes, and of the
//! namespaces.

use roxmltree::{Document, Error};

/// Largest length of a tag in bytes. Tags of cameras' files have some hundred.
const LONGEST_TAG: usize = 1 << 14;
/// Largest number of namespaces.
const MOST_NAMESPACES: usize = 64;

/// Parses an XML text.
///
/// # Errors
/// [`Error`]; also for very long tags and very many namespaces.
pub fn parse(text: &str) -> Result<Document<'_>, Error> {
    let tags = text.split('<').skip(1).map(|tag| tag.split('>').next().unwrap_or_default());
    let is_name = |tag: &&str| tag.starts_with(|letter: char| letter.is_alphabetic() || matches!(letter, '_' | ':'));
    if tags.filter(is_name).any(|tag| tag.len() > LONGEST_TAG) {
        return Err(Error::AttributesLimitReached);
    }
    if text.matches("xmlns").nth(MOST_NAMESPACES).is_some() {
        return Err(Error::NamespacesLimitReached);
    }
    Document::parse(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_attributes_and_namespaces_are_refused() {
        let attributes = |count| (0..count).map(|index| format!(" a{index}=\"\"")).collect::<String>();
        assert_eq!(parse(&format!("<a{}/>", attributes(100))).unwrap().root_element().attributes().len(), 100);
        assert!(matches!(parse(&format!("<b><a{}/></b>", attributes(10_000))), Err(Error::AttributesLimitReached)));
        let nested = |count| (0..count).map(|index| format!("<a xmlns:n{index}=\"{index}\">")).collect::<String>();
        assert!(matches!(parse(&nested(100)), Err(Error::NamespacesLimitReached)));
        // A long text is no tag.
        assert!(parse(&format!("<a>{}</a>", "1 ".repeat(LONGEST_TAG))).is_ok());
    }
}
