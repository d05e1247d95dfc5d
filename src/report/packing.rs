//! Pixels as text: floats taken apart into planes of bytes, deflated, in base64.
//!
//! Neighboring pixels agree in sign, exponent and leading bits; so the bytes of equal significance of a whole channel
//! are put one after the other, each as its difference from the one before, which deflate packs to a fraction. The page
//! undoes the three steps. Exact: floats come back by their bits.

use miniz_oxide::deflate::compress_to_vec_zlib;

/// Beyond this, deflate takes much longer for little.
const LEVEL: u8 = 3;

/// Floats as text: channels one after the other, in each the most significant bytes first.
pub fn packed_floats(channels: &[Vec<f32>]) -> String {
    let mut bytes = Vec::with_capacity(4 * channels.iter().map(Vec::len).sum::<usize>());
    for channel in channels {
        for shift in [24, 16, 8, 0] {
            bytes.extend(channel.iter().map(|value| (value.to_bits() >> shift) as u8));
        }
    }
    let mut before = 0;
    for byte in &mut bytes {
        (*byte, before) = (byte.wrapping_sub(before), *byte);
    }
    base64(&compress_to_vec_zlib(&bytes, LEVEL))
}

const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Base64 of RFC 4648, padded.
pub fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for triple in bytes.chunks(3) {
        let at = |index: usize| u32::from(triple.get(index).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for place in 0..4 {
            let is_padding = place > triple.len();
            text.push(if is_padding { '=' } else { char::from(ALPHABET[(bits >> (18 - 6 * place) & 63) as usize]) });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_has_the_published_values() {
        // RFC 4648, section 10.
        for (bytes, text) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("fooba", "Zm9vYmE="), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }

    fn unpacked(text: &str, count: usize) -> Vec<u32> {
        let digits: Vec<u32> =
            text.bytes().filter_map(|byte| ALPHABET.iter().position(|digit| *digit == byte)).map(|at| at as u32).collect();
        let bits: Vec<u8> = digits.iter().flat_map(|digit| (0..6).rev().map(move |bit| (digit >> bit & 1) as u8)).collect();
        let packed: Vec<u8> = bits.chunks_exact(8).map(|byte| byte.iter().fold(0, |value, bit| value << 1 | bit)).collect();
        let mut bytes = miniz_oxide::inflate::decompress_to_vec_zlib(&packed).unwrap();
        (1..bytes.len()).for_each(|at| bytes[at] = bytes[at].wrapping_add(bytes[at - 1]));
        let plane = |channel: usize, plane: usize, index: usize| u32::from(bytes[(4 * channel + plane) * count + index]);
        let value = |channel, index| (0..4).fold(0, |value, step| value << 8 | plane(channel, step, index));
        (0..bytes.len() / 4 / count).flat_map(|channel| (0..count).map(move |index| (channel, index))).map(|(c, i)| value(c, i)).collect()
    }

    #[test]
    fn floats_come_back_by_their_bits() {
        let channel = vec![0.0, -0.0, 1.0, f32::INFINITY, f32::from_bits(0x7fc0_1234), 1e-40, f32::MAX];
        let other: Vec<f32> = (0..7).map(|index| 0.1 * index as f32).collect();
        let expected: Vec<u32> = channel.iter().chain(&other).map(|value| value.to_bits()).collect();
        assert_eq!(unpacked(&packed_floats(&[channel, other]), 7), expected);
    }
}
