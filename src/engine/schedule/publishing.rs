//! Files of settled jobs: which are in place, which are written, and what is noted of them.

use super::Scheduler;
use super::worker::{Fault, FileToPublish, PublishTask};
use crate::engine::artifact::Origin;
use crate::engine::digest::Digest;
use crate::engine::events::Event;
use crate::engine::key;
use crate::engine::manifest::{Outcome, PublishedEntry, result_name};
use crate::engine::store::library::Lost;
use crate::engine::store::objects::Shelf;
use crate::engine::store::record::PublicationRecord;

impl Scheduler<'_> {
    /// Finds the files of a settled job that are not in place, and has them published.
    pub(super) fn plan_publications(&mut self, job: usize) {
        let shared = self.shared.clone();
        let mut files = Vec::new();
        for (publication, wanted) in shared.graph.jobs[job].publications.iter().enumerate() {
            if self.state(job).published.contains(&publication) {
                continue;
            }
            let file = self.file_to_publish(job, publication);
            match &file.record {
                Some(record) if self.is_in_place(&wanted.path, record.content.digest) => {
                    let record = record.clone();
                    self.note_file(job, publication, &record);
                }
                _ => files.push(file),
            }
        }
        if !files.is_empty() {
            self.state_mut(job).uses += 1;
            self.to_publish.push_back(PublishTask { job, files });
        }
    }

    pub(super) fn file_to_publish(&self, job: usize, publication: usize) -> FileToPublish {
        let wanted = &self.shared.graph.jobs[job].publications[publication];
        let source = self.source(job, wanted.result);
        let (origin, key) = self.origin(job, publication, source.key, source.blob.digest);
        let known = self.index.publication(&key).cloned();
        let record = known.or_else(|| self.shared.library.publication(&key).ok());
        FileToPublish { publication, key, origin, source, record }
    }

    /// What is written inside a file of a job, and its key.
    fn origin(&self, job: usize, publication: usize, key: Digest, content: Digest) -> (Origin, Digest) {
        let graph = &self.shared.graph;
        let node = &graph.jobs[job];
        let wanted = &node.publications[publication];
        let stage = &graph.stages[node.stage];
        let (result_name, type_name) = stage.results[wanted.result];
        let point = if result_name.is_empty() { "" } else { "." };
        let origin = Origin {
            pipeline: graph.pipeline.clone(),
            stage: format!("{}{point}{result_name}", stage.name),
            coordinate: node.coordinate.to_string(),
            key: key.to_string(),
        };
        let version = self.shared.artifact_kind(type_name).encoder_version;
        let key = key::publication_key(type_name, &content, &wanted.format, version, &origin);
        (origin, key)
    }

    /// Brings near the records of the files of jobs whose results are known, all at once.
    pub(super) fn fetch_publications(&self, jobs: &[usize]) {
        let keys = jobs.iter().flat_map(|&job| {
            let record = self.state(job).planned.record.as_ref();
            let publications = self.shared.graph.jobs[job].publications.iter().enumerate();
            publications.filter_map(move |(publication, wanted)| {
                let record = record?;
                let key = self.origin(job, publication, record.key, record.outputs[wanted.result].content.digest).1;
                self.index.publication(&key).is_none().then_some(key)
            })
        });
        self.shared.library.fetch(Shelf::Publications, keys);
    }

    /// Whether a published file has its bytes; tells if someone has changed it.
    pub(super) fn is_in_place(&mut self, path: &str, digest: Digest) -> bool {
        let Some(found) = self.shared.outputs.content_of(path, self.signatures) else { return false };
        if found != digest && self.standing.and_then(|standing| standing.digest_of(path)) != Some(found) {
            self.ledger.has_passing_warnings = true;
            self.ledger.warnings.push((String::new(), format!("`{path}` had been changed since it was published, and was replaced")));
        }
        found == digest
    }

    pub(super) fn take_files(&mut self, job: usize, files: Vec<(usize, PublicationRecord)>) {
        for (publication, record) in files {
            let path = self.shared.graph.jobs[job].publications[publication].path.clone();
            self.listener.notify(&Event::Published { path: path.clone() });
            self.ledger.written.push(path);
            self.note_file(job, publication, &record);
        }
    }

    pub(super) fn note_file(&mut self, job: usize, publication: usize, record: &PublicationRecord) {
        let graph = &self.shared.graph;
        let node = &graph.jobs[job];
        let wanted = &node.publications[publication];
        let name = result_name(graph, node, wanted.result);
        self.ledger.published.push(PublishedEntry { path: wanted.path.clone(), sha256: record.content.digest, job: name });
        self.ledger.publication_keys.insert(wanted.path.clone(), record.key);
        self.ledger.index.add_publication(record);
        for warning in &record.warnings {
            self.warn(job, warning.clone());
        }
        self.state_mut(job).published.push(publication);
    }

    pub(super) fn publish_again(&mut self, job: usize, lost: Vec<(usize, Lost)>) {
        let reason = lost.first().map_or("result missing", |(_, what)| what.reason());
        // Its files are planned again when it has settled again.
        if !self.run_again(job, reason) {
            self.fail_publishing(job, Fault::System("the store keeps losing a result".into()));
        }
    }

    pub(super) fn fail_publishing(&mut self, job: usize, fault: Fault) {
        let (message, hint, is_of_the_system) = match fault {
            Fault::Failed { message, hint } => (message, hint, false),
            Fault::System(message) => (message, None, true),
            Fault::Interrupted | Fault::Withdrawn | Fault::Lost(_) => {
                self.look_for_interrupt();
                return;
            }
        };
        let failure = self.failure(job, message, hint, is_of_the_system);
        let state = self.state_mut(job);
        state.entry.error = Some(failure.message.clone());
        state.entry.outcome = Outcome::Failed;
        self.tell_finished(job, Some(failure.clone()));
        self.ledger.failures.push(failure);
        self.stop_unless_keeping_on(is_of_the_system);
    }
}
