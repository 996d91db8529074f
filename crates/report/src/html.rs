//! Building blocks of self-contained HTML pages.

use std::fmt::Write;

use crate::Sample;

const STYLE: &str = "\
:root{color-scheme:light}body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:1100px;padding:1rem;color:#222;background:#fff}\
h1{font-size:1.5rem;margin:.5rem 0}h2{font-size:1.15rem;margin:1.6rem 0 .5rem}\
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,460px),1fr));gap:1rem}\
.samples{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,250px),1fr));gap:.6rem}\
figure{margin:0}figcaption{font-size:.85rem;color:#555}img,svg{width:100%;height:auto;display:block}\
.scroll{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums}\
td,th{padding:.25rem .7rem;border-bottom:1px solid #ddd;text-align:right;white-space:nowrap}\
td:first-child,th:first-child{text-align:left}th{background:#f4f4f4}\
pre{overflow-x:auto;background:#f4f4f4;padding:.7rem;font-size:.8rem}footer{color:#666;font-size:.85rem;margin-top:2rem}";

/// A page with nothing outside it: style, plots and images are part of the text.
pub fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"><title>{title}</title>\
         <style>{STYLE}</style></head>\n<body>\n<h1>{title}</h1>\n{body}</body></html>\n"
    )
}

/// Text with the characters that HTML reserves replaced.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A section with a heading.
pub fn section(heading: &str, content: &str) -> String {
    format!("<section><h2>{}</h2>\n{content}</section>\n", escape(heading))
}

/// A table; the cells are text, not HTML.
pub fn table(header: &[String], rows: &[Vec<String>]) -> String {
    let row = |cells: &[String], tag: &str| {
        let cells: Vec<String> = cells.iter().map(|c| format!("<{tag}>{}</{tag}>", escape(c))).collect();
        format!("<tr>{}</tr>\n", cells.concat())
    };
    let body: String = rows.iter().map(|cells| row(cells, "td")).collect();
    format!("<div class=\"scroll\"><table>\n{}{body}</table></div>\n", row(header, "th"))
}

/// Plots beside each other where there is room, below each other where there is not.
pub fn plots(svgs: &[String]) -> String {
    let figures: Vec<String> = svgs.iter().map(|svg| format!("<figure>{}</figure>\n", fluid(svg))).collect();
    format!("<div class=\"grid\">\n{}</div>\n", figures.concat())
}

/// Sample frames in a grid.
pub fn samples(samples: &[Sample]) -> String {
    let mut text = String::from("<div class=\"samples\">\n");
    for sample in samples {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "<figure><img alt=\"frame {}\" src=\"{}\"><figcaption>{}</figcaption></figure>",
            sample.stamp,
            sample.data_uri(),
            escape(&sample.caption)
        );
    }
    text + "</div>\n"
}

/// An SVG without fixed size, so that the page decides.
fn fluid(svg: &str) -> String {
    let Some((head, rest)) = svg.split_once('>') else { return svg.to_owned() };
    let kept: Vec<&str> = head.split(' ').filter(|a| !a.starts_with("width=") && !a.starts_with("height=")).collect();
    format!("{}>{rest}", kept.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_escaped() {
        let html = table(&["a".into()], &[vec!["<b> & \"c\"".into()]]);
        assert!(html.contains("<td>&lt;b&gt; &amp; &quot;c&quot;</td>"));
    }

    #[test]
    fn plots_lose_their_fixed_size_only() {
        let svg = "<svg width=\"720\" height=\"460\" viewBox=\"0 0 720 460\" xmlns=\"x\">\n<rect width=\"1\"/></svg>";
        assert_eq!(fluid(svg), "<svg viewBox=\"0 0 720 460\" xmlns=\"x\">\n<rect width=\"1\"/></svg>");
    }
}
