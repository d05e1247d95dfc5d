//! The page of a run: what it holds, what it leaves out, and that nothing in it is trusted.

use std::collections::BTreeSet;
use std::io::Read;
use std::net::TcpListener;

use crate::space::Space;

const BODY: &str = r#"params: { label: "plain" }
axes: { n: [16, 64], gamma: [1.0, 2.2] }
stages:
  env: { synthesize: { name: sun-sky, width: 64 } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
  cut: { median-cut: { of: env, count: 8 }, save: json }
  sphere: { relight: { env: env, with: samples, size: 31 }, save: exr }
  exact: { relight: { env: env, estimator: exact, size: 31 }, save: pfm }
  ldr: { tone-map: { of: sphere, gamma: $gamma }, save: png }
  error: { compare: { of: sphere, to: exact, metrics: [rmse], map: rmse } }
  curve: { plot: { of: error, x: n, y: [rmse], title: $label }, save: svg }
  errors: { table: { of: error }, save: csv }
"#;

fn ran() -> Space {
    let space = Space::new();
    space.pipeline(BODY);
    space.run(&["run", "p.yaml", "-q"]).expect(0, &[]);
    space
}

fn page(space: &Space, arguments: &[&str]) -> String {
    let finished = space.run(&[&["report", "p", "-q"], arguments].concat());
    finished.expect(0, &[]);
    String::from_utf8(space.read(finished.stdout.trim_end())).unwrap()
}

/// What a reader sees without scripts: everything but the elements whose text is not shown.
fn without_scripts(page: &str) -> String {
    let mut text = page.to_owned();
    for (open, close) in [("<script", "</script>"), ("<style", "</style>")] {
        while let Some(start) = text.find(open) {
            let end = start + text[start..].find(close).unwrap() + close.len();
            text.replace_range(start..end, "");
        }
    }
    text.replace("&#x2f;", "/")
}

#[test]
fn without_scripts_the_page_shows_pictures_plots_tables_and_times() {
    let page = without_scripts(&page(&ran(), &[]));
    for text in [
        "<h1>p <span class=\"status done\">done</span></h1>",
        "alt=\"sphere[n=16]\"",
        "href=\"sphere/n%3D16.exr\"",
        "src=\"data:image/svg+xml;base64,",
        "sphere against exact",
        "Critical path",
        "pipeline run p.yaml",
        "never ran",
    ] {
        assert!(page.contains(text), "`{text}` is missing");
    }
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 2 + 1 + 4 + 2 + 1, "a preview of every image");
}

#[test]
fn equal_runs_give_equal_bytes_wherever_the_page_lies() {
    let space = ran();
    let first = page(&space, &[]);
    assert_eq!(first, page(&space, &[]));
    // A run that changes nothing has the page of the run whose results stand.
    space.run(&["run", "p.yaml", "-q", "--report"]).expect(0, &[]);
    assert_eq!(first.as_bytes(), space.read("outputs/p/report.html"));
    let elsewhere = page(&space, &["--out", "elsewhere.html"]);
    assert!(!elsewhere.contains("href=\"sphere") && elsewhere.contains("alt=\"sphere[n=16]\""));
}

#[test]
fn nothing_runs_or_is_fetched_but_the_pages_own_script() {
    let page = page(&ran(), &[]);
    let policy = page.split("http-equiv=\"Content-Security-Policy\" content=\"").nth(1).unwrap().split('"').next().unwrap();
    assert!(policy.starts_with("default-src 'none'; script-src 'sha256-"), "{policy}");
    assert!(!policy.contains("unsafe") && !policy.contains("http"));
    let shown = without_scripts(&page);
    assert!(!shown.contains(" style=") && !shown.contains(" onclick="), "the policy would not allow it");
    for address in ["http://", "https://", "src=\"//"] {
        assert!(!shown.contains(address), "{address}");
    }
}

#[test]
fn texts_of_the_pipeline_are_text() {
    let space = Space::new();
    let evil = r#"</script><img src=x onerror=alert(1)>\"'&\u202Eabc"#;
    space.pipeline(&format!(
        "axes: {{ look: [\"{evil}\"] }}\nstages:\n  env: {{ synthesize: {{ name: gradient, width: 8 }} }}\n  \
         dist: {{ distribution: {{ of: env }} }}\n  rows: {{ profile: {{ of: dist }} }}\n  \
         curve: {{ plot: {{ of: rows, x: row, y: [pdf], title: $look }}, save: svg }}\n"
    ));
    space.run(&["run", "p.yaml", "-q"]).expect(0, &[]);
    let page = page(&space, &[]);
    assert!(page.contains("\\u{202e}abc") && page.contains("&lt;img src=x"), "it is there, written out");
    assert!(!page.contains("<img src=x") && !page.contains('\u{202e}'));
    assert_eq!(page.matches("</script>").count(), page.matches("<script").count());
}

#[test]
fn a_small_budget_puts_pixels_beside_the_page() {
    let space = ran();
    let whole = page(&space, &[]);
    assert!(space.files("outputs/p/report.files").is_empty(), "all of it fits");
    let budget = whole.len() - 10_000;
    let small = page(&space, &["--budget", &budget.to_string()]);
    assert!(small.len() <= budget, "{} of {budget}", small.len());
    let beside = space.files("outputs/p/report.files");
    assert!(!beside.is_empty());
    let text = String::from_utf8(space.read(&format!("outputs/p/report.files/{}", beside[0]))).unwrap();
    assert!(text.starts_with("pipelineData(\"1-") && text.ends_with("\")\n"));
    page(&space, &[]);
    assert!(space.files("outputs/p/report.files").is_empty(), "what no page needs is removed");
}

#[test]
fn what_is_gone_is_said_and_published_files_stand_in() {
    let space = ran();
    let with_store = page(&space, &[]);
    std::fs::remove_dir_all(space.path("outputs/.store")).unwrap();
    let finished = space.run(&["report", "p"]);
    finished.expect(0, &["gone from the store"]);
    let without = String::from_utf8(space.read("outputs/p/report.html")).unwrap();
    assert!(without.contains("gone from the store") && without.contains("<code>env</code>"));
    let preview = |page: &str| page.split("alt=\"sphere[n=16]\"").next().unwrap().rsplit("base64,").next().unwrap().to_owned();
    assert_eq!(preview(&with_store), preview(&without), "the published file has the same pixels");
    // A file that someone has changed is not the run's.
    std::fs::write(space.path("outputs/p/sphere/n=16.exr"), b"PF\n1 1\n-1.0\n000000000000").unwrap();
    space.run(&["report", "p"]).expect(0, &["gone from the store"]);
    let changed = String::from_utf8(space.read("outputs/p/report.html")).unwrap();
    assert!(changed.contains("sphere[n=16]") && !changed.contains("alt=\"sphere[n=16]\""));
}

#[test]
fn a_failed_run_has_a_page_that_says_why() {
    let space = Space::new();
    space.write("bad.pfm", "PF\n2 2\n-1.0\nshort");
    space.pipeline("stages:\n  env: { load: { path: bad.pfm } }\n  half: { synthesize: { name: gradient, width: 8 }, save: pfm }\n");
    let finished = space.run(&["run", "p.yaml", "-k", "--report"]);
    assert_eq!(finished.code, 1, "{}", finished.stderr);
    let page = String::from_utf8(space.read("outputs/p/report.html")).unwrap();
    assert!(page.contains("status failed") && page.contains("1 failed") && page.contains("truncated"));
}

#[test]
fn a_run_that_does_not_exist_is_refused() {
    Space::new().run(&["report", "nothing"]).expect(2, &["there is no run `nothing`"]);
}

/// The messages of tev's protocol: the sort of each, and what follows.
fn messages(mut bytes: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut messages = Vec::new();
    while let Some((length, _)) = bytes.split_first_chunk() {
        let (message, rest) = bytes.split_at(u32::from_le_bytes(*length) as usize);
        messages.push((message[4], message[6..].to_vec()));
        bytes = rest;
    }
    messages
}

#[test]
fn finished_images_go_to_a_viewer_that_listens() {
    let space = Space::new();
    space.pipeline(BODY);
    for round in ["as they are finished", "from the store"] {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let option = format!("--view={}", listener.local_addr().unwrap());
        let received = std::thread::spawn(move || {
            let mut bytes = Vec::new();
            listener.accept().unwrap().0.read_to_end(&mut bytes).unwrap();
            bytes
        });
        space.run(&["run", "p.yaml", "-q", &option]).expect(0, &[]);
        let messages = messages(&received.join().unwrap());
        let name = |body: &[u8]| String::from_utf8_lossy(body.split(|byte| *byte == 0).next().unwrap()).into_owned();
        let created: Vec<String> = messages.iter().filter(|(sort, _)| *sort == 4).map(|(_, body)| name(body)).collect();
        let images: BTreeSet<String> =
            space.files("outputs/p").into_iter().filter(|file| ["pfm", "exr", "png"].iter().any(|end| file.ends_with(end))).collect();
        assert_eq!(created.iter().cloned().collect::<BTreeSet<_>>(), images, "{round}");
        assert_eq!(created.len(), images.len(), "each once, {round}");
        // The red channel of a PFM, whose rows go from the bottom up.
        let red = messages.iter().find(|(sort, body)| *sort == 3 && body.starts_with(b"exact.pfm\0R\0")).unwrap();
        let file = space.read("outputs/p/exact.pfm");
        let last_row = &file[file.len() - 12 * 31..];
        let start = b"exact.pfm\0R\0".len() + 16;
        assert_eq!(red.1[start + 4 * 15..start + 4 * 16], last_row[12 * 15..12 * 15 + 4]);
    }
}

#[test]
fn without_a_viewer_nothing_is_said() {
    let space = Space::new();
    space.pipeline(BODY);
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let finished = space.run(&["run", "p.yaml", "-q", &format!("--view={free}")]);
    assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
}
