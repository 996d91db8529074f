//! Clusters of particles on the image (algorithm 2, step 5): connected cells of a density grid.

use crate::particle_filter::Particle;

/// Side of a density cell, pixels of an image of so many columns: about twice the particles' jitter.
const CELL: f32 = 20.0;
const COLUMNS: f32 = 640.0;
/// A cell belongs to a cluster when it holds this many times the particles that a uniform spread would put there.
const DENSITY: f32 = 2.0;

/// Indices of the particles of each cluster, the largest first.
pub fn clusters(particles: &[Particle], (width, height): (usize, usize)) -> Vec<Vec<usize>> {
    let side = CELL * (width as f32 / COLUMNS).max(f32::MIN_POSITIVE);
    let columns = (width as f32 / side).ceil().max(1.0) as usize;
    let rows = (height as f32 / side).ceil().max(1.0) as usize;
    let cell = |p: &Particle| {
        let (u, v) = ((p.x / side).max(0.0) as usize, (p.y / side).max(0.0) as usize);
        v.min(rows - 1) * columns + u.min(columns - 1)
    };
    let mut members = vec![Vec::new(); columns * rows];
    for (k, p) in particles.iter().enumerate() {
        members[cell(p)].push(k);
    }
    let dense = DENSITY * particles.len() as f32 / (columns * rows) as f32;
    let mut open: Vec<bool> = members.iter().map(|m| m.len() as f32 > dense).collect();
    let mut found = Vec::new();
    for seed in 0..open.len() {
        if open[seed] {
            let cells = connected(seed, columns, &mut open);
            found.push(cells.into_iter().flat_map(|c| members[c].iter().copied()).collect::<Vec<usize>>());
        }
    }
    found.sort_by_key(|c| std::cmp::Reverse(c.len()));
    found
}

/// The open cells connected to `seed` (8 neighbours), closing them.
fn connected(seed: usize, columns: usize, open: &mut [bool]) -> Vec<usize> {
    let rows = open.len() / columns;
    let mut cells = vec![seed];
    open[seed] = false;
    let mut next = 0;
    while next < cells.len() {
        let (u, v) = (cells[next] % columns, cells[next] / columns);
        next += 1;
        for y in v.saturating_sub(1)..(v + 2).min(rows) {
            for x in u.saturating_sub(1)..(u + 2).min(columns) {
                let c = y * columns + x;
                if std::mem::take(&mut open[c]) {
                    cells.push(c);
                }
            }
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_groups_the_larger_first() {
        let at = |x: f32, y: f32| Particle { x, y, vx: 0.0, vy: 0.0 };
        let mut particles: Vec<Particle> = (0..30).map(|i| at(50.0 + i as f32, 60.0)).collect();
        particles.extend((0..60).map(|i| at(400.0 + i as f32, 300.0)));
        particles.push(at(600.0, 20.0));
        let found = clusters(&particles, (640, 480));
        assert!(found.len() >= 2);
        assert_eq!(found[0].len(), 60);
        assert!(found[0].iter().all(|&k| (30..90).contains(&k)));
        assert_eq!(found[1].len(), 30);
    }
}
