//! Words of commands that people paste into a shell, or that a shell reads.

/// A word of a POSIX shell; what cannot be seen is written as the escapes of `$'…'`, so that what is read is what is run.
pub fn word(text: &str) -> String {
    let is_plain = |character: char| character.is_ascii_alphanumeric() || "@%+=:,./_-".contains(character);
    let is_seen = |character: char| (' '..='~').contains(&character) || character.is_alphanumeric();
    match () {
        () if !text.is_empty() && text.chars().all(is_plain) => text.to_owned(),
        () if text.chars().all(is_seen) => format!("'{}'", text.replace('\'', r"'\''")),
        () => format!("$'{}'", text.chars().map(escaped).collect::<String>()),
    }
}

fn escaped(character: char) -> String {
    match character {
        '\'' | '\\' => format!("\\{character}"),
        ' '..='~' => character.to_string(),
        _ if character.is_alphanumeric() => character.to_string(),
        _ if u32::from(character) < 0x1_0000 => format!("\\u{:04x}", u32::from(character)),
        _ => format!("\\U{:08x}", u32::from(character)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_only_where_a_shell_would_read_them_otherwise() {
        for (text, expected) in [
            ("n=64", "n=64"),
            ("sphere[n=64]", "'sphere[n=64]'"),
            ("it's", r"'it'\''s'"),
            ("", "''"),
            ("$(rm -rf ~)", "'$(rm -rf ~)'"),
            ("a\u{202e}b'\n", r"$'a\u202eb\'\u000a'"),
        ] {
            assert_eq!(word(text), expected);
        }
    }

    #[test]
    fn a_shell_reads_back_what_was_quoted() {
        for text in ["sphere[n=64]", "it's $HOME `x`", "a\u{202e}b'\\\n", "Größe \u{1f600}!"] {
            let command = format!("printf %s {}", word(text));
            let Ok(output) = std::process::Command::new("bash").args(["-c", &command]).env("LC_ALL", "C.UTF-8").output() else { return };
            assert_eq!(String::from_utf8(output.stdout).unwrap(), text);
        }
    }
}
