//! Building blocks of self-contained HTML pages.

use std::fmt::Write;

use crate::Sample;

const STYLE: &str = "\
:root{color-scheme:light}body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:1200px;padding:1rem;color:#222;background:#fff}\
h1{font-size:1.5rem;margin:.5rem 0}h2{font-size:1.15rem;margin:1.6rem 0 .5rem}\
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,460px),1fr));gap:1rem}\
.samples{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,250px),1fr));gap:.6rem}\
figure{margin:0}figcaption{font-size:.85rem;color:#555}img,svg{width:100%;height:auto;display:block}\
.scroll{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums}\
td,th{padding:.25rem .7rem;border-bottom:1px solid #ddd;text-align:right;white-space:nowrap}\
td:first-child,th:first-child{text-align:left;white-space:normal}th{background:#f4f4f4;white-space:normal;vertical-align:bottom}\
.text{white-space:normal;text-align:left;font-size:.85rem;min-width:9rem}\
@media(max-width:640px){.cards,.cards tbody,.cards tr{display:block}.cards thead{display:none}\
.cards tr{border:1px solid #ccc;border-radius:6px;margin:.6rem 0;padding:.3rem .6rem}\
.cards td{display:flex;justify-content:space-between;gap:1rem;border:0;padding:.1rem 0;white-space:normal;overflow-wrap:anywhere}\
.cards td::before{content:attr(data-label);color:#555;white-space:nowrap}\
.cards td:first-child{font-weight:600;border-bottom:1px solid #ddd}.cards td:first-child::before{content:none}}\
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

/// Columns that fit on a phone beside each other.
const NARROW: usize = 3;
/// Characters beyond which a cell is text that may take several lines.
const LONG: usize = 30;

/// A table; the cells are text, not HTML. On a phone the rows of a wide one become cards, each cell with its column's name.
pub fn table(header: &[String], rows: &[Vec<String>]) -> String {
    // Long names may break between their parts.
    let name = |name: &String| {
        ['_', '-', '.', '='].iter().fold(escape(name), |name, part| name.replace(*part, &format!("{part}<wbr>")))
    };
    let names: Vec<String> = header.iter().map(|n| format!("<th>{}</th>", name(n))).collect();
    let cell = |(i, text): (usize, &String)| {
        let label = header.get(i).map_or("", String::as_str);
        let class = if i > 0 && text.chars().count() > LONG { " class=\"text\"" } else { "" };
        format!("<td{class} data-label=\"{}\">{}</td>", escape(label), escape(text))
    };
    let row =
        |cells: &Vec<String>| format!("<tr>{}</tr>\n", cells.iter().enumerate().map(cell).collect::<Vec<_>>().concat());
    let body: Vec<String> = rows.iter().map(row).collect();
    let class = if header.len() > NARROW { " class=\"cards\"" } else { "" };
    format!(
        "<div class=\"scroll\"><table{class}>\n<thead><tr>{}</tr></thead>\n<tbody>\n{}</tbody></table></div>\n",
        names.concat(),
        body.concat()
    )
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
        assert!(html.contains("<td data-label=\"a\">&lt;b&gt; &amp; &quot;c&quot;</td>"));
    }

    #[test]
    fn wide_tables_become_cards_on_a_phone() {
        let header = |n: usize| (0..n).map(|i| i.to_string()).collect::<Vec<_>>();
        assert!(table(&header(NARROW + 1), &[]).contains("class=\"cards\""));
        assert!(!table(&header(NARROW), &[]).contains("cards"));
    }

    #[test]
    fn plots_lose_their_fixed_size_only() {
        let svg = "<svg width=\"720\" height=\"460\" viewBox=\"0 0 720 460\" xmlns=\"x\">\n<rect width=\"1\"/></svg>";
        assert_eq!(fluid(svg), "<svg viewBox=\"0 0 720 460\" xmlns=\"x\">\n<rect width=\"1\"/></svg>");
    }
}
