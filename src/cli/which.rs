//! `pipeline which`: from a file back to the stage, the parameters and the run that made it.

use std::fs;

use super::Ending;
use super::arguments::{Format, WhichCommand};
use super::screen::{Screen, escaped_lines, json_text};
use crate::engine::artifact::Origin;
use crate::engine::digest::Digest;
use crate::engine::manifest::{JobEntry, place_text, plain_text};
use crate::engine::provenance::origin::{self, FoundOrigin};
use crate::stages::origin::origin_in;

/// Says where a file comes from.
pub fn which(command: &WhichCommand, screen: &Screen) -> Ending {
    let read = match fs::metadata(&command.file) {
        Ok(status) if !status.is_file() => Err("it is not a regular file".to_owned()),
        Ok(_) => fs::read(&command.file).map_err(|error| error.to_string()),
        Err(error) => Err(error.to_string()),
    };
    let bytes = match read {
        Ok(bytes) => bytes,
        Err(what) => {
            screen.error(&format!("cannot read `{}`: {what}", command.file.display()), None);
            return Ending::Refused;
        }
    };
    let inside = origin_in(&bytes);
    let pipeline = inside.as_ref().map(|origin| origin.pipeline.as_str()).filter(|name| !name.is_empty());
    let key = inside.as_ref().map(|origin| origin.key.as_str());
    let found = origin::find(&command.outputs, Digest::of(&bytes), pipeline, key);
    if found.is_none() && inside.is_none() {
        let message =
            format!("`{}` says nothing of its origin, and no run in `{}` published it", command.file.display(), command.outputs.display());
        screen.error(&message, Some("`--outputs DIR` names the folder in which its run is to be looked for"));
        return Ending::Failed;
    }
    if command.format == Format::Json {
        return screen.print(&json_text(&json_of(inside.as_ref(), found.as_ref())));
    }
    screen.print(&escaped_lines(&text_of(inside.as_ref(), found.as_ref())))
}

fn text_of(inside: Option<&Origin>, found: Option<&FoundOrigin>) -> String {
    let mut lines = Vec::new();
    let mut add = |name: &str, text: String| lines.push(format!("{name:<11} {text}\n"));
    if let Some(origin) = inside {
        add("pipeline", origin.pipeline.clone());
        let coordinate = if origin.coordinate.is_empty() { String::new() } else { format!("[{}]", origin.coordinate) };
        add("stage", format!("{}{coordinate}", origin.stage));
        add("key", origin.key.clone());
    }
    let Some(found) = found else {
        add("run", "none of those in the folder of outputs has it".into());
        return lines.concat();
    };
    let entry = found.entry();
    if inside.is_none() {
        add("pipeline", found.run.manifest.pipeline.clone());
        let name = found.published.as_ref().map(|published| published.job.clone());
        add("stage", name.unwrap_or_else(|| place_text(&entry.stage, &entry.coordinate)));
        add("key", entry.key.map(|key| key.to_string()).unwrap_or_default());
    }
    add("kind", format!("{} (version {})", entry.kind, entry.version));
    for (index, (name, value)) in parameters(entry).into_iter().enumerate() {
        add(if index == 0 { "parameters" } else { "" }, format!("{name}: {value}"));
    }
    let mut inputs: Vec<String> = entry.inputs.iter().map(|input| place_text(&input.stage, &input.coordinate)).collect();
    inputs.extend(entry.files.iter().map(|file| file.path.clone()));
    if !inputs.is_empty() {
        add("inputs", super::outcomes::some(&inputs.iter().map(String::as_str).collect::<Vec<_>>(), 68));
    }
    add("run", found.run.manifest.run_id.clone());
    match &found.published {
        Some(published) => {
            add("published", found.folder().map_or(published.path.clone(), |folder| folder.join(&published.path).display().to_string()))
        }
        None => add("published", "with other bytes: the file was changed, or another version of the program wrote it".into()),
    }
    lines.concat()
}

fn parameters(entry: &JobEntry) -> Vec<(String, String)> {
    let fields = entry.parameters.as_object().into_iter().flatten();
    fields.map(|(name, value)| (name.clone(), plain_text(value))).collect()
}

fn json_of(inside: Option<&Origin>, found: Option<&FoundOrigin>) -> serde_json::Value {
    let inside = inside.map(|origin| {
        let entries = origin.entries().into_iter().map(|(name, text)| (name.to_owned(), serde_json::json!(text)));
        entries.collect::<serde_json::Map<_, _>>()
    });
    let run = found.map(|found| {
        serde_json::json!({
            "run_id": found.run.manifest.run_id,
            "result_id": found.run.manifest.result_id,
            "pipeline": found.run.manifest.pipeline,
            "manifest": found.run.path,
            "published": found.published,
            "job": found.entry(),
        })
    });
    serde_json::json!({ "origin": inside, "run": run })
}
