//! The pieces of which canonical byte forms are made: a versioned header, little-endian numbers, floats by bits.
//!
//! Lists are written and read in pieces of 64 KiB, so that a length that lies costs no memory.

use std::io::{self, Read, Write};

/// Bytes that are converted at once.
const PIECE: usize = 1 << 16;

/// Writes the parts of one artifact in order.
pub struct Encoder<'a> {
    out: &'a mut dyn Write,
    piece: Vec<u8>,
}

impl<'a> Encoder<'a> {
    /// Begins the form `version` of the artifact type `type_name`.
    pub fn new(out: &'a mut dyn Write, type_name: &str, version: u32) -> io::Result<Self> {
        let mut encoder = Self { out, piece: Vec::with_capacity(PIECE) };
        encoder.put(format!("pipeline {type_name} {version}\n").as_bytes())?;
        Ok(encoder)
    }

    /// Writes bytes as they are.
    pub fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.piece.len() + bytes.len() > PIECE {
            self.flush()?;
        }
        if bytes.len() > PIECE {
            return self.out.write_all(bytes);
        }
        self.piece.extend_from_slice(bytes);
        Ok(())
    }

    /// Writes a byte.
    pub fn byte(&mut self, value: u8) -> io::Result<()> {
        self.put(&[value])
    }

    /// Writes a count.
    pub fn count(&mut self, value: u64) -> io::Result<()> {
        self.put(&value.to_le_bytes())
    }

    /// Writes floats of single precision.
    pub fn singles(&mut self, values: &[f32]) -> io::Result<()> {
        values.iter().try_for_each(|value| self.put(&value.to_le_bytes()))
    }

    /// Writes floats of double precision.
    pub fn doubles(&mut self, values: &[f64]) -> io::Result<()> {
        values.iter().try_for_each(|value| self.put(&value.to_le_bytes()))
    }

    /// Writes what is left. Without it the end is missing.
    pub fn finish(mut self) -> io::Result<()> {
        self.flush()
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.write_all(&self.piece)?;
        self.piece.clear();
        Ok(())
    }
}

/// Reads the parts of one artifact in order.
pub struct Decoder<'a> {
    input: &'a mut dyn Read,
}

impl<'a> Decoder<'a> {
    /// Begins to read, if the input is the form `version` of the artifact type `type_name`.
    pub fn new(input: &'a mut dyn Read, type_name: &str, version: u32) -> io::Result<Self> {
        let expected = format!("pipeline {type_name} {version}\n");
        let mut found = vec![0; expected.len()];
        read_all(input, &mut found)?;
        if found == expected.as_bytes() { Ok(Self { input }) } else { Err(invalid(&format!("not a `{type_name}` of version {version}"))) }
    }

    /// The next bytes.
    pub fn take<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        read_all(self.input, &mut bytes)?;
        Ok(bytes)
    }

    /// A byte.
    pub fn byte(&mut self) -> io::Result<u8> {
        Ok(self.take::<1>()?[0])
    }

    /// A count that fits this machine.
    pub fn count(&mut self) -> io::Result<usize> {
        let count = u64::from_le_bytes(self.take()?);
        usize::try_from(count).map_err(|_| invalid("a count too large for this machine"))
    }

    /// As many floats of single precision.
    pub fn singles(&mut self, count: usize) -> io::Result<Vec<f32>> {
        self.list(count, f32::from_le_bytes)
    }

    /// As many floats of double precision.
    pub fn doubles(&mut self, count: usize) -> io::Result<Vec<f64>> {
        self.list(count, f64::from_le_bytes)
    }

    /// As many items of `N` bytes each. Grows with what is really there.
    pub fn list<const N: usize, T>(&mut self, count: usize, item: impl Fn([u8; N]) -> T) -> io::Result<Vec<T>> {
        let per_piece = (PIECE / N).max(1);
        let mut piece = vec![0; per_piece.min(count) * N];
        let mut items = Vec::new();
        while items.len() < count {
            let next = per_piece.min(count - items.len());
            read_all(self.input, &mut piece[..next * N])?;
            items.extend(piece[..next * N].chunks_exact(N).map(|bytes| item(bytes.try_into().expect("a chunk of N bytes"))));
        }
        Ok(items)
    }

    /// Ends, if nothing follows.
    pub fn finish(self) -> io::Result<()> {
        let mut rest = [0];
        if self.input.read(&mut rest)? == 0 { Ok(()) } else { Err(invalid("bytes after the end")) }
    }
}

/// An error for bytes that are not what they should be.
pub fn invalid(message: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

/// Fills `bytes`; input that ends before is invalid, not a failure of the system.
fn read_all(input: &mut dyn Read, bytes: &mut [u8]) -> io::Result<()> {
    input.read_exact(bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => invalid("the end is missing"),
        _ => error,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_nothing_else() {
        let singles: Vec<f32> = (0..40_000).map(|k| k as f32).collect();
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, "thing", 3).unwrap();
        encoder.byte(7).unwrap();
        encoder.count(9).unwrap();
        encoder.singles(&singles).unwrap();
        encoder.doubles(&[f64::NEG_INFINITY]).unwrap();
        encoder.finish().unwrap();

        let read = |bytes: &[u8]| -> io::Result<()> {
            let mut input = bytes;
            let mut decoder = Decoder::new(&mut input, "thing", 3)?;
            assert_eq!((decoder.byte()?, decoder.count()?), (7, 9));
            assert_eq!(decoder.singles(40_000)?, singles);
            assert_eq!(decoder.doubles(1)?, [f64::NEG_INFINITY]);
            decoder.finish()
        };
        read(&bytes).unwrap();
        let kind = |bytes: &[u8]| read(bytes).unwrap_err().kind();
        assert_eq!(kind(&bytes[..bytes.len() - 1]), io::ErrorKind::InvalidData);
        assert_eq!(kind(&[bytes.clone(), vec![0]].concat()), io::ErrorKind::InvalidData);
        assert_eq!(kind(b"pipeline thing 2\n..."), io::ErrorKind::InvalidData);
    }

    #[test]
    fn a_length_that_lies_costs_no_memory() {
        let mut bytes = Vec::new();
        Encoder::new(&mut bytes, "thing", 1).unwrap().finish().unwrap();
        let mut input = bytes.as_slice();
        let found = Decoder::new(&mut input, "thing", 1).unwrap().doubles(usize::MAX / 16);
        assert_eq!(found.unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}
