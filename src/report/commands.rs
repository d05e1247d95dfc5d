//! The command that makes a result again, fit to be pasted into a shell.

use serde_json::Value as Json;

use crate::engine::manifest::{JobEntry, Manifest, place_text, plain_text};
use crate::engine::shell::word;

/// `pipeline run FILE …` with all that the command line of the run changed; to be given in the folder of the file.
pub fn run_command(manifest: &Manifest) -> String {
    let mut words = vec!["pipeline run".to_owned()];
    words.extend(manifest.spec.first().map(|spec| word(&spec.path)));
    for (group, flag) in [("params", "-s"), ("axes", "-a")] {
        let fields = manifest.overrides.get(group).and_then(Json::as_object).into_iter().flatten();
        words.extend(fields.map(|(name, value)| format!("{flag} {}", word(&format!("{name}={}", plain_text(value))))));
    }
    let seed = manifest.overrides.get("seed").map(plain_text);
    words.extend(seed.map(|seed| format!("--seed {}", word(&seed))));
    words.join(" ")
}

/// What makes only that job, behind [`run_command`].
pub fn only(job: &JobEntry) -> String {
    format!("--only {}", word(&place_text(&job.stage, &job.coordinate)))
}
