//! How much memory there is, and shares of it.

use std::fs;
use std::path::Path;

use crate::engine::quantity::{byte_size, number_and_unit, product};

/// What is taken for the machine's memory where nothing says it.
const ASSUMED_MEMORY: u64 = 8 << 30;

/// Bytes that jobs may take by default: 80 % of the machine's or of the control group's memory.
pub fn default_memory() -> u64 {
    available_memory() / 10 * 8
}

/// Memory of the machine, or of the smallest control group that this process is in.
fn available_memory() -> u64 {
    let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    // Version 2 has one line, `0::/path`.
    let group = groups.lines().find_map(|line| line.strip_prefix("0::/")).unwrap_or_default();
    let folders = Path::new(group).ancestors().map(|folder| Path::new("/sys/fs/cgroup").join(folder));
    let limits = folders.filter_map(|folder| fs::read_to_string(folder.join("memory.max")).ok()?.trim().parse().ok());
    limits.chain(machine_memory()).min().unwrap_or(ASSUMED_MEMORY)
}

fn machine_memory() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let words = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    words.split_whitespace().next()?.parse::<u64>().ok().map(|kibibytes| kibibytes * 1024)
}

/// A size as `4GiB`, `512M`, `1.5e9` or `50%` of the memory there is.
pub fn memory_size(text: &str) -> Result<u64, String> {
    const ADVICE: &str = "write a size as 512MiB, 4GiB or 50%";
    match number_and_unit(text) {
        (number, unit) if unit == "%" => product(number, available_memory() as f64 / 100.0).filter(|bytes| *bytes > 0.0),
        _ => return byte_size(text).ok().filter(|bytes| *bytes > 0).ok_or_else(|| ADVICE.to_owned()),
    }
    .map(|bytes| bytes as u64)
    .ok_or_else(|| ADVICE.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_people_write_them() {
        assert_eq!(memory_size("1GiB"), Ok(1 << 30));
        assert_eq!(memory_size("512m"), Ok(512 << 20));
        assert_eq!(memory_size("1.5 KB"), Ok(1500));
        assert_eq!(memory_size("100"), Ok(100));
        assert!(memory_size("50%").unwrap() < available_memory());
        for bad in ["banana", "", "-1GiB", "0", "1XB", "nan", "inf", "1e400"] {
            assert!(memory_size(bad).is_err(), "{bad}");
        }
    }
}
