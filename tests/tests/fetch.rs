//! `pfd-slam fetch` against a server on this machine.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;

use pfd_tests::programs;

const NAME: &str = "rgbd_dataset_freiburg3_tiny";

/// An archive of a sequence with one frame.
fn archive(folder: &Path) -> Vec<u8> {
    let sequence = folder.join(NAME);
    std::fs::create_dir_all(&sequence).unwrap();
    let bundled = pfd_tests::bundled_sequence();
    std::fs::copy(bundled.join("rgb/1305031104.175424.jpg"), sequence.join("rgb.jpg")).unwrap();
    std::fs::copy(bundled.join("depth/1305031104.163440.png"), sequence.join("depth.png")).unwrap();
    std::fs::write(sequence.join("rgb.txt"), "1.0 rgb.jpg\n").unwrap();
    std::fs::write(sequence.join("depth.txt"), "1.0 depth.png\n").unwrap();
    let path = folder.join("a.tgz");
    let status = std::process::Command::new("tar").arg("-C").arg(folder).arg("-czf").arg(&path).arg(NAME).status();
    assert!(status.unwrap().success());
    std::fs::remove_dir_all(sequence).unwrap();
    std::fs::read(path).unwrap()
}

/// Answers HEAD and GET (whole, or from an offset) for one file, and everything else with 404.
fn serve(content: Vec<u8>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let content = Arc::new(content);
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            answer(stream, &content);
        }
    });
    format!("http://{address}/dataset")
}

fn answer(mut stream: TcpStream, content: &[u8]) {
    let mut reader = BufReader::new(stream.try_clone().unwrap());
    let mut request = String::new();
    let mut offset = 0;
    while reader.read_line(&mut request).unwrap_or(0) > 2 {
        let line = request.lines().last().unwrap_or_default().to_lowercase();
        if let Some(range) = line.strip_prefix("range: bytes=") {
            offset = range.trim_end_matches('-').parse().unwrap();
        }
    }
    let known = request.split_whitespace().nth(1) == Some(&format!("/dataset/freiburg3/{NAME}.tgz"));
    let part = &content[offset..];
    let head = match (known, offset) {
        (false, _) => "HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n".to_owned(),
        (true, 0) => format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n", part.len()),
        (true, _) => format!(
            "HTTP/1.1 206 Partial Content\r\nContent-Length: {}\r\nContent-Range: bytes {offset}-{}/{}\r\n",
            part.len(),
            content.len() - 1,
            content.len()
        ),
    };
    stream.write_all(format!("{head}Connection: close\r\n\r\n").as_bytes()).unwrap();
    if known && !request.starts_with("HEAD") {
        stream.write_all(part).unwrap();
    }
}

fn fetch(url: &str, out: &Path, name: &str) -> std::process::Output {
    programs::pfd_slam().unwrap().args(["fetch", name, "--base-url", url, "--out"]).arg(out).output().unwrap()
}

#[test]
fn fetches_resumes_and_unpacks() {
    let (source, out) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let content = archive(source.path());
    let url = serve(content.clone());
    // An earlier attempt got this far.
    std::fs::write(out.path().join(format!("{NAME}.tgz.part")), &content[..content.len() / 2]).unwrap();
    for expected in ["1 frames", "1 frames"] {
        let output = fetch(&url, out.path(), "fr3_tiny");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(String::from_utf8_lossy(&output.stdout).contains(expected));
    }
    let left: Vec<_> = std::fs::read_dir(out.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, [NAME]);
}

#[test]
fn says_what_could_not_be_fetched() {
    let out = tempfile::tempdir().unwrap();
    let url = serve(Vec::new());
    for (name, part) in [("freiburg3_no_such", "404"), ("kitchen", "not a sequence of the benchmark")] {
        let output = fetch(&url, out.path(), name);
        assert_eq!(output.status.code(), Some(1));
        assert!(String::from_utf8_lossy(&output.stderr).contains(part), "{output:?}");
    }
}
