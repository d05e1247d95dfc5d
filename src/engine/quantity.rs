//! Sizes and times as people write them.

use std::time::Duration;

/// A number of bytes as `4GiB`, `512M` or `1.5e9`; also none.
pub fn byte_size(text: &str) -> Result<u64, String> {
    let (number, unit) = number_and_unit(text);
    let factor = match unit.as_str() {
        "" | "b" => 1.0,
        "k" | "kib" => 1024.0,
        "m" | "mib" => 1048576.0,
        "g" | "gib" => 1073741824.0,
        "t" | "tib" => 1099511627776.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        _ => return Err("write a size as 512MiB or 4GiB".to_owned()),
    };
    product(number, factor).map(|bytes| bytes as u64).ok_or_else(|| "write a size as 512MiB or 4GiB".to_owned())
}

/// A time as `45s`, `90m`, `12h`, `30d` or `8w`.
pub fn duration(text: &str) -> Result<Duration, String> {
    const ADVICE: &str = "write a time as 45s, 90m, 12h, 30d or 8w";
    let (number, unit) = number_and_unit(text);
    let factor = match unit.as_str() {
        "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        "d" => 86400.0,
        "w" => 604800.0,
        _ => return Err(ADVICE.to_owned()),
    };
    product(number, factor).and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()).ok_or_else(|| ADVICE.to_owned())
}

/// What stands before and in the unit, which is in small letters.
pub fn number_and_unit(text: &str) -> (&str, String) {
    let text = text.trim();
    let digits = text.trim_end_matches(|letter: char| letter.is_ascii_alphabetic() || letter == '%');
    (digits.trim(), text[digits.len()..].to_ascii_lowercase())
}

/// A number that is finite and not negative, times a factor.
pub fn product(number: &str, factor: f64) -> Option<f64> {
    let value = number.parse::<f64>().ok().filter(|value| *value >= 0.0)?;
    Some(value * factor).filter(|product| product.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_people_write_them() {
        assert_eq!(byte_size("1GiB"), Ok(1 << 30));
        assert_eq!(byte_size("0"), Ok(0));
        assert!(byte_size("50%").is_err() && byte_size("-1").is_err());
    }

    #[test]
    fn times_are_read_as_people_write_them() {
        assert_eq!(duration("30d"), Ok(Duration::from_secs(30 * 86400)));
        assert_eq!(duration("1.5h"), Ok(Duration::from_secs(5400)));
        assert_eq!(duration("0s"), Ok(Duration::ZERO));
        for bad in ["", "5", "-1d", "d", "1y", "nand", "1e300w"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }
}
