//! Parser of Python literals: strings, whole numbers, words, tuples, lists and dictionaries.

/// Nesting limit; the header of an array is never nested deeper.
const DEEPEST: usize = 16;

/// A Python literal.
#[derive(Clone, Debug, PartialEq)]
pub enum Literal<'a> {
    /// A string in single or double quotes.
    Text(&'a str),
    /// A non-negative integer.
    Whole(u64),
    /// `True`, `False` or `None`.
    Word(&'a str),
    /// A tuple, a list, or alternating keys and values of a dictionary.
    Items(Vec<Literal<'a>>),
}

impl<'a> Literal<'a> {
    /// The items, if it is a tuple or list.
    pub fn items(&self) -> Option<&[Literal<'a>]> {
        match self {
            Self::Items(items) => Some(items),
            _ => None,
        }
    }

    /// The text, if it is a string.
    pub fn text(&self) -> Option<&'a str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The value, if it is an integer.
    pub fn whole(&self) -> Option<u64> {
        match self {
            Self::Whole(value) => Some(*value),
            _ => None,
        }
    }

    /// The value of a key, if it is a dictionary with that key.
    pub fn key(&self, name: &str) -> Option<&Literal<'a>> {
        let (pairs, _) = self.items()?.as_chunks();
        pairs.iter().find(|[key, _]| key.text() == Some(name)).map(|[_, value]| value)
    }
}

/// Parses `text` as a single literal, possibly with spaces around it.
pub fn parse(text: &str) -> Option<Literal<'_>> {
    let (value, rest) = value(text, 0)?;
    rest.trim().is_empty().then_some(value)
}

fn value(text: &str, depth: usize) -> Option<(Literal<'_>, &str)> {
    let text = text.trim_start();
    let first = text.chars().next().filter(|_| depth <= DEEPEST)?;
    let inside = text.get(first.len_utf8()..)?;
    match first {
        '\'' | '"' => {
            let (content, rest) = inside.split_once(first)?;
            Some((Literal::Text(content), rest))
        }
        '(' => items(inside, ')', depth),
        '[' => items(inside, ']', depth),
        '{' => items(inside, '}', depth),
        '0'..='9' => {
            let (digits, rest) = leading(text, |character| character.is_ascii_digit())?;
            // Python 2 writes an L after some numbers.
            Some((Literal::Whole(digits.parse().ok()?), rest.strip_prefix('L').unwrap_or(rest)))
        }
        _ => {
            let (word, rest) = leading(text, char::is_alphabetic)?;
            (!word.is_empty()).then_some((Literal::Word(word), rest))
        }
    }
}

fn leading(text: &str, of: impl Fn(char) -> bool) -> Option<(&str, &str)> {
    text.split_at_checked(text.find(|character| !of(character)).unwrap_or(text.len()))
}

/// Parses values up to `end`, separated by commas or colons. The last one may be followed by a separator too.
fn items(mut text: &str, end: char, depth: usize) -> Option<(Literal<'_>, &str)> {
    let mut items = Vec::new();
    loop {
        text = text.trim_start();
        if let Some(rest) = text.strip_prefix(end) {
            return Some((Literal::Items(items), rest));
        }
        let (item, rest) = value(text, depth + 1)?;
        items.push(item);
        let rest = rest.trim_start();
        text = match rest.strip_prefix([',', ':']) {
            Some(rest) => rest,
            None if rest.starts_with(end) => rest,
            None => return None,
        };
    }
}
