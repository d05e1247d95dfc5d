//! `pipeline info` and `pipeline convert`: the code of `load` and `save` on one file.

use std::fs;
use std::io::Write;
use std::path::Path;

use super::Ending;
use super::arguments::{ConvertCommand, Format, InfoCommand};
use super::screen::{Screen, escaped_lines, json_text};
use crate::stages::conversion::{self, Info};

/// Shows what an image file holds.
pub fn info(command: &InfoCommand, screen: &Screen) -> Ending {
    let bytes = match read(&command.file, screen) {
        Ok(bytes) => bytes,
        Err(ending) => return ending,
    };
    match conversion::info(&bytes, &name_of(&command.file), &Default::default()) {
        Ok(info) if command.format == Format::Json => screen.print(&json_text(&info)),
        Ok(info) => {
            info.warnings.iter().for_each(|warning| screen.warning(warning));
            screen.print(&escaped_lines(&text_of(&command.file, &info)))
        }
        Err(error) => bad_file(&command.file, &error.to_string(), screen),
    }
}

fn text_of(path: &Path, info: &Info) -> String {
    let mut lines = vec![format!("{}: {}, {} x {}", path.display(), info.format, info.width, info.height)];
    let mut add = |name: &str, value: String| lines.push(format!("  {name:<18} {value}"));
    if info.has_alpha {
        add("alpha", "yes".into());
    }
    if !info.layers.is_empty() {
        add("layers", info.layers.join(", "));
    }
    for (name, value) in info.facts.iter().chain(&info.origin) {
        add(name, value.clone());
    }
    let pixels = &info.pixels;
    let triple = |values: &[f64; 3]| values.map(|value| format!("{value:.6}")).join(" ");
    add("values", pixels.values.into());
    add("smallest", triple(&pixels.min_rgb));
    add("largest", triple(&pixels.max_rgb));
    add("mean", triple(&pixels.mean_rgb));
    add("mean intensity", format!("{:.6}", pixels.mean_intensity));
    if let Some(integral) = &pixels.integral_rgb {
        add("over the sphere", triple(integral));
    }
    add("brightest pixel", format!("{}, {}", pixels.brightest.0, pixels.brightest.1));
    add("black pixels", pixels.zero_count.to_string());
    add("negative pixels", pixels.negative_count.to_string());
    add("not finite", pixels.non_finite_count.to_string());
    lines.join("\n") + "\n"
}

/// Converts an image file.
pub fn convert(command: &ConvertCommand, screen: &Screen) -> Ending {
    let bytes = match read(&command.input, screen) {
        Ok(bytes) => bytes,
        Err(ending) => return ending,
    };
    match conversion::convert(&bytes, &name_of(&command.input), &name_of(&command.output), &Default::default()) {
        Err(error) => bad_file(&command.input, &error.to_string(), screen),
        Ok((bytes, warnings)) => {
            warnings.iter().for_each(|warning| screen.warning(warning));
            write(&command.output, &bytes, screen)
        }
    }
}

/// The file appears whole or not at all.
fn write(path: &Path, bytes: &[u8], screen: &Screen) -> Ending {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let written = (|| {
        use std::os::unix::fs::PermissionsExt;
        let mut file = tempfile::Builder::new().permissions(fs::Permissions::from_mode(0o666)).tempfile_in(folder)?;
        file.write_all(bytes)?;
        file.persist(path).map_err(|error| error.error)
    })();
    match written {
        Ok(_) => Ending::Done,
        Err(error) => {
            screen.error(&format!("cannot write `{}`: {error}", path.display()), None);
            Ending::System
        }
    }
}

fn read(path: &Path, screen: &Screen) -> Result<Vec<u8>, Ending> {
    let is_regular = fs::metadata(path).map(|status| status.is_file());
    let bytes = match is_regular {
        Ok(false) => Err("not a regular file".to_owned()),
        _ => fs::read(path).map_err(|error| error.to_string()),
    };
    bytes.map_err(|what| {
        screen.error(&format!("cannot read `{}`: {what}", path.display()), None);
        Ending::Refused
    })
}

fn bad_file(path: &Path, message: &str, screen: &Screen) -> Ending {
    screen.error(&format!("`{}`: {message}", path.display()), None);
    Ending::Failed
}

fn name_of(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}
