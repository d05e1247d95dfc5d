//! Keys: what a job's result depends on, in one unambiguous byte form, hashed.
//!
//! A key names a result by the content of its inputs, so that a change which produces the same bytes stops
//! there. A recipe names it by everything that went before, so that it is known without any result at hand.
//! Neither holds a stage's name, a path, a machine, a thread count or a time.

use serde_json::Value as Json;

use super::artifact::{Origin, TypeName};
use super::coordinate::Scalar;
use super::digest::Digest;
use super::graph::{Graph, InputNode, JobNode};
use super::lines;

/// Fields one after the other, each with its length before it, so that no two lists of fields agree. They are few bytes, and
/// hashed at once.
struct Fields(Vec<u8>);

impl Fields {
    fn new(purpose: &str) -> Self {
        let mut fields = Self(Vec::with_capacity(1 << 10));
        fields.text(purpose);
        fields
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend((bytes.len() as u64).to_le_bytes());
        self.0.extend(bytes);
    }

    fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    fn number(&mut self, number: u64) {
        self.0.extend(number.to_le_bytes());
    }

    fn digest(&mut self, digest: &Digest) {
        self.0.extend(digest.0);
    }

    fn scalar(&mut self, value: &Scalar) {
        match value {
            Scalar::Boolean(value) => {
                self.text("boolean");
                self.number(u64::from(*value));
            }
            Scalar::Integer(value) => {
                self.text("integer");
                self.0.extend(value.to_le_bytes());
            }
            Scalar::Number(value) => {
                self.text("number");
                self.number(value.to_bits());
            }
            Scalar::Text(value) => {
                self.text("text");
                self.text(value);
            }
        }
    }

    fn finish(self) -> Digest {
        Digest::of(&self.0)
    }
}

/// Key of a job whose inputs are known: `content` gives the digest of a result.
///
/// `files` are the digests of its input files in the order of [`JobNode::files`].
pub fn key(graph: &Graph, job: &JobNode, files: &[Digest], content: impl Fn(&InputNode) -> Digest) -> Digest {
    of_job("pipeline key 1", graph, job, &job.canonical, files, |fields, item| fields.digest(&content(item)))
}

/// Key of the job that differs from this one by its parameters alone; they are one of [`JobNode::prefixes`].
pub fn key_of_prefix(graph: &Graph, job: &JobNode, prefix: &Json, files: &[Digest], content: impl Fn(&InputNode) -> Digest) -> Digest {
    of_job("pipeline key 1", graph, job, prefix, files, |fields, item| fields.digest(&content(item)))
}

/// Recipe of a job: `recipe` gives that of an earlier job by its index.
pub fn recipe(graph: &Graph, job: &JobNode, files: &[Digest], recipe: impl Fn(usize) -> Digest) -> Digest {
    of_job("pipeline recipe 1", graph, job, &job.canonical, files, |fields, item| {
        fields.digest(&recipe(item.job));
        fields.number(item.result as u64);
    })
}

fn of_job(
    purpose: &str,
    graph: &Graph,
    job: &JobNode,
    canonical: &Json,
    files: &[Digest],
    mut input: impl FnMut(&mut Fields, &InputNode),
) -> Digest {
    let stage = &graph.stages[job.stage];
    let mut fields = Fields::new(purpose);
    fields.text(stage.kind);
    fields.number(u64::from(stage.version));
    fields.text(&canonical_text(canonical));
    fields.text(&format!("{:?}", job.seed));

    // Users may have decided between the types a kind can give (`load`): that is part of what is computed.
    fields.number(stage.results.len() as u64);
    for (name, type_name) in &stage.results {
        fields.text(name);
        fields.text(type_name);
    }

    fields.number(files.len() as u64);
    for ((name, _), digest) in job.files.iter().zip(files) {
        fields.text(name);
        fields.digest(digest);
    }

    // By name of the port and not by the order in which a reader of the file happened to list them. The sort
    // is stable: the references of one collecting port keep their order, which a table shows.
    let mut ports: Vec<_> = job.inputs.iter().collect();
    ports.sort_by(|a, b| a.port.cmp(&b.port));
    fields.number(ports.len() as u64);
    for port in ports {
        fields.text(&port.port);
        fields.number(u64::from(port.collects));
        fields.number(port.items.len() as u64);
        for item in &port.items {
            fields.text(result_type(graph, item));
            input(&mut fields, item);
            if port.collects {
                label(&mut fields, item);
            }
        }
    }
    fields.finish()
}

fn label(fields: &mut Fields, item: &InputNode) {
    fields.text(&item.label);
    fields.number(item.columns.len() as u64);
    for (name, value) in &item.columns {
        fields.text(name);
        fields.scalar(value);
    }
}

fn result_type(graph: &Graph, item: &InputNode) -> TypeName {
    graph.stages[graph.jobs[item.job].stage].results[item.result].1
}

/// Name of an encoded file: the artifact, how it is written, and what is written into it of its origin.
pub fn publication_key(type_name: TypeName, artifact: &Digest, format: &str, encoder_version: u32, origin: &Origin) -> Digest {
    let mut fields = Fields::new("pipeline publication 1");
    fields.text(type_name);
    fields.digest(artifact);
    fields.text(format);
    fields.number(u64::from(encoder_version));
    for (name, value) in origin.entries() {
        fields.text(name);
        fields.text(value);
    }
    fields.finish()
}

/// JSON with the keys of every object sorted and no spaces.
pub fn canonical_text(value: &Json) -> String {
    let mut text = Vec::with_capacity(128);
    add_canonical(value, &mut text);
    String::from_utf8(text).expect("JSON is UTF-8")
}

/// Adds the same to another text.
pub fn add_canonical(value: &Json, text: &mut Vec<u8>) {
    match value {
        Json::Object(fields) => {
            let mut entries: Vec<_> = fields.iter().collect();
            entries.sort_unstable_by_key(|(name, _)| *name);
            text.push(b'{');
            for (index, (name, value)) in entries.into_iter().enumerate() {
                if index > 0 {
                    text.push(b',');
                }
                lines::add_text(name, text);
                text.push(b':');
                add_canonical(value, text);
            }
            text.push(b'}');
        }
        Json::Array(items) => {
            text.push(b'[');
            for (index, item) in items.iter().enumerate() {
                if index > 0 {
                    text.push(b',');
                }
                add_canonical(item, text);
            }
            text.push(b']');
        }
        Json::String(value) => lines::add_text(value, text),
        plain => lines::add_line(plain, text),
    }
}
