//! Slurm, by its command line: one array of workers for each class, one look at the queue every ten seconds.
//!
//! Nothing rests on accounting, dependencies or requeueing, which sites set up in many ways. A worker that the queue does not
//! know any more is gone, whatever became of it: an acknowledged submission can vanish with the controller.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use super::{Class, Executor, ExecutorError, Present, Row, Terms, worker_arguments};
use crate::engine::shell;

/// See [`super::EXECUTORS`].
pub const ROW: Row = Row {
    name: "slurm",
    about: "an array of workers on a Slurm cluster; the profile says where",
    outlives_driver: true,
    make: |terms| Box::new(Slurm { terms }),
};

/// So long before its time is over a worker is told to begin no more jobs, at most.
const NOTICE: u64 = 60;

/// A worker takes so much of the memory that it was given, in percent: the rest is for what is not estimated.
const MEMORY_SHARE: u64 = 90;

struct Slurm {
    terms: Terms,
}

impl Slurm {
    fn script(&self, class: &Class) -> String {
        let profile = &self.terms.profile;
        let program = profile.program.as_ref().unwrap_or(&self.terms.program);
        let mut words = vec![program.display().to_string()];
        words.extend(worker_arguments(&self.terms, class));
        if let Some(memory) = self.memory(class) {
            words.extend(["--memory".to_owned(), (memory / 100 * MEMORY_SHARE).to_string()]);
        }
        let command: Vec<String> = words.iter().map(|word| shell::word(word)).collect();
        let setup: String = profile.setup.iter().map(|line| format!("{line}\n")).collect();
        // The worker takes the place of the shell, so that it hears the signals of the scheduler.
        format!(
            "#!/bin/bash\n{setup}exec {} --name \"slurm-${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}\" --jobs \"${{SLURM_CPUS_PER_TASK:-1}}\"\n",
            command.join(" ")
        )
    }

    fn memory(&self, class: &Class) -> Option<u64> {
        class.resources.memory.or(self.terms.memory).or(self.terms.profile.memory)
    }

    /// The time of a worker: what its class asks for is that of one job.
    fn seconds(&self, class: &Class) -> Option<u64> {
        class.resources.seconds.max(self.terms.profile.seconds)
    }

    fn options(&self, class: &Class, count: usize) -> Vec<String> {
        let profile = &self.terms.profile;
        let threads = class.resources.threads.or(self.terms.threads).map(usize::from).or(profile.threads).unwrap_or(1);
        let log = self.terms.folder.workers().join("slurm-%A_%a.log");
        let mut options = vec![
            "--parsable".to_owned(),
            format!("--job-name={}", self.terms.folder.job_name()),
            format!("--comment=class-{}", class.number),
            format!("--array=0-{}", count - 1),
            format!("--cpus-per-task={threads}"),
            "--ntasks=1".to_owned(),
            // Replacing a worker is the driver's affair, and quicker.
            "--no-requeue".to_owned(),
            "--open-mode=append".to_owned(),
            format!("--output={}", log.display()),
        ];
        if let Some(seconds) = self.seconds(class) {
            options.push(format!("--time={}", seconds.div_ceil(60)));
            options.push(format!("--signal=B:USR1@{}", NOTICE.min(seconds / 4)));
        }
        options.extend(self.memory(class).map(|bytes| format!("--mem={}M", bytes.div_ceil(1 << 20))));
        let named = [("partition", &profile.partition), ("account", &profile.account), ("qos", &profile.qos)];
        options.extend(named.iter().filter_map(|(name, value)| Some(format!("--{name}={}", value.as_ref()?))));
        options.extend(profile.options.iter().cloned());
        options
    }

    /// The options that mean all jobs of this run.
    fn own_jobs(&self) -> [String; 2] {
        [format!("--user={}", rustix::process::geteuid().as_raw()), format!("--name={}", self.terms.folder.job_name())]
    }

    /// What the queue says: the id of each job of this run with its class, state and reason.
    fn queue(&self) -> Option<Vec<Queued>> {
        let output =
            Command::new("squeue").args(["--noheader", "--array", "--format=%F|%K|%k|%T|%r"]).args(self.own_jobs()).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).lines().filter_map(Queued::parse).collect())
    }

    fn run(program: &str, arguments: &[String], input: &str) -> Result<String, ExecutorError> {
        let said = |message: String, hint: Option<&str>| ExecutorError { message, hint: hint.map(str::to_owned) };
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| {
            said(
                format!("cannot run `{program}`: {error}"),
                Some("is this a machine from which jobs are submitted? `sinfo` must work there"),
            )
        })?;
        let _ = child.stdin.take().map(|mut stdin| stdin.write_all(input.as_bytes()));
        let output = child.wait_with_output().map_err(|error| said(format!("`{program}`: {error}"), None))?;
        if output.status.success() {
            return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
        }
        let text = String::from_utf8_lossy(&output.stderr);
        let lines: Vec<&str> = text.lines().map(|line| line.trim_start_matches("sbatch: ").trim_start_matches("error: ")).collect();
        Err(said(
            format!("`{program}` says: {}", lines.join("; ")),
            Some("correct the profile: `sinfo` lists partitions, `sacctmgr show associations user=$USER` accounts; then run again"),
        ))
    }
}

/// A line of the queue.
#[derive(Debug, PartialEq, Eq)]
struct Queued {
    job: String,
    task: String,
    class: Option<usize>,
    state: String,
    reason: String,
}

impl Queued {
    fn parse(line: &str) -> Option<Self> {
        let mut fields = line.trim().splitn(5, '|').map(str::to_owned);
        let (job, task, comment) = (fields.next()?, fields.next()?, fields.next()?);
        let class = comment.strip_prefix("class-").and_then(|number| number.parse().ok());
        Some(Self { job, task, class, state: fields.next()?, reason: fields.next()? })
    }

    /// Whether it has a future. A start that failed is held until a person comes; so is what a lost controller made of it.
    fn is_held_for_good(&self) -> bool {
        let reason = self.reason.to_ascii_lowercase();
        reason.contains("held") && !reason.contains("jobheld")
    }

    fn is_there(&self) -> bool {
        matches!(self.state.as_str(), "PENDING" | "RUNNING" | "CONFIGURING" | "SUSPENDED" | "REQUEUED") && !self.is_held_for_good()
    }

    fn present(&self) -> Present {
        // Slurm has not looked at it yet where its reason is `None`.
        let waits_for = (self.state == "PENDING" && self.reason != "None").then(|| self.reason.clone());
        Present { name: format!("slurm-{}_{}", self.job, self.task), class: self.class, waits_for }
    }
}

impl Executor for Slurm {
    fn start(&mut self, class: &Class, count: usize) -> Result<(), ExecutorError> {
        let script = self.script(class);
        // For the reader: what was submitted last.
        let _ = fs::write(self.terms.folder.path().join(format!("class-{}.sh", class.number)), &script);
        Self::run("sbatch", &self.options(class, count), &script).map(drop)
    }

    fn present(&mut self) -> Option<Vec<Present>> {
        let queue = self.queue()?;
        for held in queue.iter().filter(|queued| queued.is_held_for_good()) {
            let _ = Self::run("scancel", &[format!("{}_{}", held.job, held.task)], "");
        }
        Some(queue.iter().filter(|queued| queued.is_there()).map(Queued::present).collect())
    }

    fn cancel(&mut self) -> Result<(), ExecutorError> {
        Self::run("scancel", &self.own_jobs(), "").map(drop)
    }

    /// Those that run find the order to end; those that wait for a machine would start for nothing.
    fn dismiss(&mut self) {
        let [user, name] = self.own_jobs();
        let _ = Self::run("scancel", &[user, name, "--state=PENDING".to_owned()], "");
    }

    fn interval(&self) -> Duration {
        Duration::from_secs(10)
    }

    fn log_of(&self, name: &str) -> PathBuf {
        self.terms.folder.workers().join(format!("{name}.log"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_queue_is_a_worker_unless_it_has_no_future() {
        let queued = Queued::parse("17|3|class-1|RUNNING|None").unwrap();
        assert_eq!(queued.present(), Present { name: "slurm-17_3".into(), class: Some(1), waits_for: None });
        let pending = Queued::parse("17|4|class-1|PENDING|Nodes required for job are DOWN, DRAINED or reserved").unwrap();
        assert_eq!(pending.present().waits_for.unwrap(), "Nodes required for job are DOWN, DRAINED or reserved");
        assert!(queued.is_there());
        for (line, is_there) in [
            ("17|3|class-1|PENDING|Resources", true),
            ("17|3|class-1|PENDING|launch failed requeued held", false),
            ("17|3|class-1|PENDING|JobHeldUser", true),
            ("17|3|class-1|COMPLETING|None", false),
            ("17|3|class-1|NODE_FAIL|None", false),
        ] {
            assert_eq!(Queued::parse(line).unwrap().is_there(), is_there, "{line}");
        }
        assert_eq!(Queued::parse("17|3|RUNNING"), None);
    }

    #[test]
    fn a_path_with_spaces_stays_one_word_of_the_script() {
        assert_eq!(shell::word("/a/b-c_1.yaml"), "/a/b-c_1.yaml");
        assert_eq!(shell::word("/my folder/it's"), "'/my folder/it'\\''s'");
    }
}
