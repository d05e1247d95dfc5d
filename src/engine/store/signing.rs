//! Who vouches for a record: Ed25519 signatures, and the keys that are trusted.
//!
//! A blob proves itself, since its name is the digest of its bytes. A record does not: whoever may write to a store can
//! say that a key has another result. So a record that leaves this machine can be signed, and records from elsewhere
//! can be required to be signed by one of a list of keys. A signature is a line below the sealed record, and covers the
//! shelf and all of the record, its key included: a record moved to another name, shelf or text is not signed.
//! Signatures are after Bernstein et al., "High-speed high-security signatures" (2012), RFC 8032.

use std::fmt;
use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use ed25519_compact::{KeyPair, PublicKey as RawPublicKey, Seed, Signature};

use super::objects::Shelf;
use crate::engine::digest::{bytes_from_hex, hex_from_bytes};
use crate::engine::files::PlainFile;

/// With this the text of a public key begins, and the line of a signature.
const PUBLIC: &str = "ed25519:";

/// With this the text of a secret key begins.
const SECRET: &str = "ed25519-secret:";

/// What is signed begins with this, so that a signature means nothing elsewhere.
const PURPOSE: &str = "pipeline store record, version 1";

/// No file of keys is longer.
const FILE_LIMIT: u64 = 1 << 20;

/// Tells whose signature something bears.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PublicKey([u8; 32]);

/// Signs.
#[derive(Clone)]
pub struct SecretKey(KeyPair);

/// Text that is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read or written.
    #[error("cannot read `{place}`: {source}")]
    Unreadable {
        /// The file.
        place: String,
        /// What the system said.
        source: io::Error,
    },
    /// What stands there is no key.
    #[error("{place}: {what}")]
    NoKey {
        /// Where it stands.
        place: String,
        /// What is wrong.
        what: &'static str,
    },
}

impl fmt::Display for PublicKey {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{PUBLIC}{}", hex_from_bytes(&self.0))
    }
}

impl fmt::Debug for SecretKey {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "the secret key of {}", self.public())
    }
}

impl PublicKey {
    fn parse(text: &str) -> Option<Self> {
        let bytes = bytes_from_hex(text.strip_prefix(PUBLIC)?)?;
        Some(Self(bytes.try_into().ok()?))
    }

    /// The key that a text is, or those in the file that it names.
    ///
    /// In a file, each line is a key, which words may follow that say whose it is; empty lines and those that begin with `#` are
    /// passed over.
    pub fn all_of(text: &str) -> Result<Vec<Self>, KeyError> {
        if text.starts_with(PUBLIC) {
            let what = "a public key is `ed25519:` and 64 hexadecimal digits";
            return Self::parse(text).map(|key| vec![key]).ok_or_else(|| KeyError::NoKey { place: format!("`{text}`"), what });
        }
        let content = text_of(Path::new(text))?;
        let lines = content.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
        let mut keys = Vec::new();
        for (number, line) in lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#')) {
            let key = line.split_whitespace().next().and_then(Self::parse);
            let no_key = || KeyError::NoKey { place: format!("{text}:{number}"), what: no_public_key(line) };
            keys.push(key.ok_or_else(no_key)?);
        }
        if keys.is_empty() {
            return Err(KeyError::NoKey { place: format!("`{text}`"), what: "there is no key in it" });
        }
        Ok(keys)
    }

    fn has_signed(&self, message: &[u8], signature: &[u8; 64]) -> bool {
        RawPublicKey::new(self.0).verify(message, &Signature::new(*signature)).is_ok()
    }
}

fn no_public_key(line: &str) -> &'static str {
    match line.starts_with(SECRET) {
        true => "this is a secret key: give out the public one, which `store keygen` wrote beside it",
        false => "a line of a list of trusted keys begins with `ed25519:` and 64 hexadecimal digits",
    }
}

impl SecretKey {
    /// A new key, from the system's random numbers.
    pub fn draw() -> io::Result<Self> {
        let mut seed = [0; 32];
        fs::File::open("/dev/urandom")?.read_exact(&mut seed)?;
        Ok(Self(KeyPair::from_seed(Seed::new(seed))))
    }

    /// The key in a file.
    pub fn in_file(path: &Path) -> Result<Self, KeyError> {
        let text = text_of(path)?;
        let seed = text.trim().strip_prefix(SECRET).and_then(bytes_from_hex).and_then(|bytes| <[u8; 32]>::try_from(bytes).ok());
        let what = "a file of a secret key holds one line, as `pipeline store keygen` writes it";
        let seed = seed.ok_or_else(|| KeyError::NoKey { place: format!("`{}`", path.display()), what })?;
        Ok(Self(KeyPair::from_seed(Seed::new(seed))))
    }

    /// Writes the key to a new file that its user alone can read, and the public one beside it.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let mut file = fs::File::options().write(true).create_new(true).mode(0o600).open(path)?;
        writeln!(file, "{SECRET}{}", hex_from_bytes(self.0.sk.seed().as_ref()))?;
        let mut public = fs::File::options().write(true).create_new(true).open(public_path(path))?;
        writeln!(public, "{}", self.public())
    }

    /// By which others know its signatures.
    pub fn public(&self) -> PublicKey {
        PublicKey(*self.0.pk)
    }
}

/// Where the public key stands whose secret one stands there.
pub fn public_path(path: &Path) -> std::path::PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".pub");
    path.with_file_name(name)
}

fn text_of(path: &Path) -> Result<String, KeyError> {
    let mut text = String::new();
    let read = PlainFile::open_named(path.to_owned()).and_then(|file| file.take(FILE_LIMIT).read_to_string(&mut text));
    read.map(|_| text).map_err(|source| KeyError::Unreadable { place: path.display().to_string(), source })
}

/// With what records are signed that leave, and whose are taken.
#[derive(Debug, Clone, Default)]
pub struct Keys {
    /// Signs what leaves.
    pub signing: Option<SecretKey>,
    /// Whose records are taken; where there is no list, anyone's.
    pub trusted: Option<Vec<PublicKey>>,
}

/// A record that is not signed by a trusted key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Untrusted;

impl Keys {
    /// Those of a store of this machine: nothing is signed, and all is taken.
    pub const NONE: Self = Self { signing: None, trusted: None };

    /// A sealed record with a signature, if there is a key for it.
    pub fn signed(&self, shelf: Shelf, sealed: &str) -> String {
        let Some(key) = &self.signing else { return sealed.to_owned() };
        let signature = key.0.sk.sign(message(shelf, sealed), None);
        format!("{sealed}{} {}\n", key.public(), hex_from_bytes(signature.as_ref()))
    }

    /// The sealed record in a text, if it may be taken.
    pub fn admit<'t>(&self, shelf: Shelf, text: &'t str) -> Result<&'t str, Untrusted> {
        let (sealed, signature) = split(text);
        let Some(trusted) = &self.trusted else { return Ok(sealed) };
        let own = self.signing.as_ref().map(SecretKey::public);
        let (key, signature) = signature.ok_or(Untrusted)?;
        let is_trusted = trusted.contains(&key) || own == Some(key);
        (is_trusted && key.has_signed(&message(shelf, sealed), &signature)).then_some(sealed).ok_or(Untrusted)
    }
}

fn message(shelf: Shelf, sealed: &str) -> Vec<u8> {
    format!("{PURPOSE}\n{}\n{sealed}", shelf.folder_name()).into_bytes()
}

/// The sealed record in a text, and the signature below it.
pub fn split(text: &str) -> (&str, Option<(PublicKey, [u8; 64])>) {
    let signature = || {
        let body = text.strip_suffix('\n')?;
        let start = body.rfind('\n')? + 1;
        let (key, signature) = body[start..].split_once(' ')?;
        let signature = bytes_from_hex(signature)?.try_into().ok()?;
        Some((start, (PublicKey::parse(key)?, signature)))
    };
    match signature() {
        Some((start, signature)) => (&text[..start], Some(signature)),
        None => (text, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::store::record::seal;

    fn key(seed: u8) -> SecretKey {
        SecretKey(KeyPair::from_seed(Seed::new([seed; 32])))
    }

    #[test]
    fn the_scheme_is_that_of_the_standard() {
        // RFC 8032, section 7.1, test 3.
        let bytes = |text: &str| bytes_from_hex(text).unwrap();
        let seed = bytes("c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7");
        let pair = KeyPair::from_seed(Seed::new(seed.try_into().unwrap()));
        assert_eq!(pair.pk.as_ref(), bytes("fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025"));
        let signature = "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a";
        assert_eq!(pair.sk.sign([0xaf, 0x82], None).as_ref(), bytes(signature));
    }

    #[test]
    fn a_signed_record_is_taken_from_trusted_keys_alone() {
        let sealed = seal("{\"a\":1}");
        let from = |seed| Keys { signing: Some(key(seed)), trusted: None };
        let trusting = Keys { signing: None, trusted: Some(vec![key(1).public(), key(2).public()]) };
        let text = from(1).signed(Shelf::Results, &sealed);
        assert_eq!(trusting.admit(Shelf::Results, &text), Ok(sealed.as_str()));
        assert_eq!(Keys::default().admit(Shelf::Results, &text), Ok(sealed.as_str()), "without a list, anyone's");
        assert_eq!(trusting.admit(Shelf::Publications, &text), Err(Untrusted), "another shelf");
        assert_eq!(trusting.admit(Shelf::Results, &from(3).signed(Shelf::Results, &sealed)), Err(Untrusted), "another's key");
        assert_eq!(trusting.admit(Shelf::Results, &sealed), Err(Untrusted), "no signature");
        let other = text.replacen(&sealed, &seal("{\"a\":2}"), 1);
        assert_eq!(trusting.admit(Shelf::Results, &other), Err(Untrusted), "another record");
        let own = Keys { signing: Some(key(3)), trusted: Some(vec![key(1).public()]) };
        assert!(own.admit(Shelf::Results, &own.signed(Shelf::Results, &sealed)).is_ok(), "one's own");
    }

    #[test]
    fn every_damage_of_a_signature_shows() {
        let keys = Keys { signing: Some(key(1)), trusted: Some(vec![]) };
        let text = keys.signed(Shelf::Results, &seal("x"));
        for index in 0..text.len() {
            let mut bytes = text.clone().into_bytes();
            bytes[index] ^= 1;
            assert_eq!(keys.admit(Shelf::Results, &String::from_utf8(bytes).unwrap()), Err(Untrusted), "byte {index}");
        }
    }

    #[test]
    fn keys_survive_as_files_and_lists_of_them_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lab");
        let drawn = SecretKey::draw().unwrap();
        drawn.write(&path).unwrap();
        assert!(drawn.write(&path).is_err(), "a key is never written over");
        assert_eq!(SecretKey::in_file(&path).unwrap().public(), drawn.public());
        let public = public_path(&path).display().to_string();
        assert_eq!(PublicKey::all_of(&public).unwrap(), [drawn.public()]);
        assert_eq!(PublicKey::all_of(&drawn.public().to_string()).unwrap(), [drawn.public()]);
        let list = folder.path().join("list").display().to_string();
        fs::write(&list, format!("# ours\n\n{} the lab's machine\n  {}\n", key(1).public(), key(2).public())).unwrap();
        assert_eq!(PublicKey::all_of(&list).unwrap(), [key(1).public(), key(2).public()]);
        fs::write(&list, "ed25519:12\n").unwrap();
        assert!(PublicKey::all_of(&list).unwrap_err().to_string().contains("list:1: "));
        assert!(PublicKey::all_of("ed25519:zz").is_err() && PublicKey::all_of("/nowhere").is_err());
        let secret = PublicKey::all_of(&path.display().to_string()).unwrap_err();
        assert!(secret.to_string().contains("secret key"), "{secret}");
        assert!(!format!("{drawn:?}").contains("secret:"));
    }
}
