pub(crate) fn k(name: &str, default: f32) -> f32 {
    use std::collections::HashMap;
    static M: std::sync::LazyLock<HashMap<String, f32>> = std::sync::LazyLock::new(|| {
        std::env::var("K")
            .unwrap_or_default()
            .split(',')
            .filter_map(|s| s.split_once('=').map(|(a, b)| (a.to_string(), b.parse().unwrap_or(0.0))))
            .collect()
    });
    M.get(name).copied().unwrap_or(default)
}
pub(crate) struct Knobs {
    pub(crate) model_same: f32,
    pub(crate) depth_same: f32,
    pub(crate) tex_same: f32,
    pub(crate) tex_changed: f32,
    pub(crate) free: f32,
    pub(crate) before: f32,
    pub(crate) uncovered: f32,
    pub(crate) luma: f32,
    pub(crate) corner: f32,
    pub(crate) init: f32,
    pub(crate) gain: f32,
    pub(crate) half: f32,
    pub(crate) hold: f32,
    pub(crate) radius: f32,
    pub(crate) gray: f32,
    pub(crate) edge: f32,
    pub(crate) missing: f32,
    pub(crate) prev: f32,
    pub(crate) warp: f32,
    pub(crate) warpf: f32,
    pub(crate) prior: f32,
    pub(crate) sure: f32,
    pub(crate) slope: f32,
    pub(crate) mask_gray: f32,
    pub(crate) bias: f32,
    pub(crate) rel: f32,
    pub(crate) edge_same: f32,
    pub(crate) edge_size: f32,
}
pub(crate) static X: std::sync::LazyLock<Knobs> = std::sync::LazyLock::new(|| Knobs {
    model_same: k("model_same", 0.05),
    depth_same: k("depth_same", 0.01),
    tex_same: k("tex_same", 0.4),
    tex_changed: k("tex_changed", 0.5),
    free: k("free", 1.0),
    before: k("before", 1.5),
    uncovered: k("uncovered", 0.15),
    luma: k("luma", 0.4),
    corner: k("corner", 1.0),
    init: k("init", -0.5),
    gain: k("gain", 1.5),
    half: k("half", 0.15),
    hold: k("hold", 0.95),
    radius: k("radius", 20.0),
    gray: k("gray", 80.0),
    edge: k("edge", 2.0),
    missing: k("missing", 1.0),
    prev: k("prev", 0.0),
    warp: k("warp", 0.35),
    warpf: k("warpf", 0.05),
    prior: k("prior", 0.04),
    sure: k("sure", 10.0),
    slope: k("slope", 0.015),
    mask_gray: k("mask_gray", 1.0),
    bias: k("bias", 0.5),
    rel: k("rel", 0.01),
    edge_same: k("edge_same", 0.4),
    edge_size: k("edge_size", 0.05),
});
