//! The model as HTML. Every text is escaped on its way, and nothing runs but the script that stands here.

use minijinja::syntax::SyntaxConfig;
use minijinja::value::Serde;
use minijinja::{AutoEscape, Environment, context};
use serde_json::Value as Json;

use super::model::Model;
use super::packing::base64;
use crate::engine::diagnostic::escape;
use crate::engine::digest::Digest;
use crate::image::colormap::Colormap;

const TEMPLATE: &str = include_str!("page/report.html");
const STYLE: &str = include_str!("page/style.css");

/// The parts of the script, in order.
const SCRIPTS: [&str; 8] = [
    include_str!("page/data.js"),
    include_str!("page/tone.js"),
    include_str!("page/screen.js"),
    include_str!("page/sphere.js"),
    include_str!("page/viewer.js"),
    include_str!("page/grid.js"),
    include_str!("page/tables.js"),
    include_str!("page/start.js"),
];

/// The whole page.
pub fn html_page(model: &Model) -> String {
    let script = script();
    let mut values = serde_json::to_value(model).expect("the model is plain data");
    let data = json_in_html(&visible(values["data"].take()));
    let values = visible(values);
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    let syntax = SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build();
    environment.set_syntax(syntax.expect("the delimiters are the usual ones"));
    environment.add_template("report", TEMPLATE).expect("the template is right");
    let template = environment.get_template("report").expect("it was added");
    let context = context! {
        policy => policy(&script),
        style => STYLE,
        script => script,
        data => data,
        embedded => Serde(&model.texts.embedded),
        ..minijinja::Value::from(Serde(&values))
    };
    template.render(context).expect("the template fits the model")
}

/// One function, so that nothing of it is global but what data files call.
fn script() -> String {
    format!("\"use strict\";(()=>{{\n{}{}}})();", color_tables(), SCRIPTS.concat())
}

/// The scales of the program's own images, as text of hexadecimal colors.
fn color_tables() -> String {
    let table = |map: Colormap| {
        (0..256).flat_map(|entry| map.color(f64::from(entry) / 255.0)).map(|code| format!("{code:02x}")).collect::<String>()
    };
    format!("const COLORS = {{ viridis: \"{}\", magma: \"{}\" }};\n", table(Colormap::Viridis), table(Colormap::Magma))
}

/// The Content-Security-Policy: nothing from anywhere, but this style, this script, and scripts that it asks for itself.
fn policy(script: &str) -> String {
    let hash = |text: &str| base64(&Digest::of(text.as_bytes()).0);
    format!(
        "default-src 'none'; script-src 'sha256-{}' 'strict-dynamic'; style-src 'sha256-{}'; img-src data: blob:; base-uri 'none'; form-action 'none'",
        hash(script),
        hash(STYLE)
    )
}

/// JSON that may stand inside an element: no character of markup.
fn json_in_html(value: &Json) -> String {
    let text = value.to_string();
    text.replace('<', "\\u003c").replace('>', "\\u003e").replace('&', "\\u0026")
}

/// Text that may stand in an element or an attribute.
pub fn html(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in escape(text).chars() {
        match character {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            other => out.push(other),
        }
    }
    out
}

/// All texts with what changes them unseen (controls of direction, zero-width marks) written out; lines stay lines.
fn visible(value: Json) -> Json {
    match value {
        Json::String(text) => Json::String(visible_text(text)),
        Json::Array(items) => items.into_iter().map(visible).collect(),
        Json::Object(fields) => Json::Object(fields.into_iter().map(|(name, value)| (visible_text(name), visible(value))).collect()),
        other => other,
    }
}

fn visible_text(text: String) -> String {
    // Long texts are base64.
    if text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        return text;
    }
    text.split('\n').map(|line| line.split('\t').map(escape).collect::<Vec<_>>().join("\t")).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_and_the_style_end_where_they_should() {
        assert!(!script().contains("</script") && !script().contains("<!--"));
        assert!(!STYLE.contains("</style"));
    }

    #[test]
    fn no_text_is_markup_or_turns_the_direction() {
        assert_eq!(html("<b>\"'&\u{202e}"), "&lt;b&gt;&quot;&#39;&amp;\\u{202e}");
        assert_eq!(visible_text("a\u{202e}b\n\tc\u{200b}".into()), "a\\u{202e}b\n\tc\\u{200b}");
        assert_eq!(json_in_html(&serde_json::json!("</script>&")), r#""\u003c/script\u003e\u0026""#);
    }
}
