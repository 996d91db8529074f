//! Recognition of places by their descriptors, without a vocabulary to load: locality-sensitive hashing of binary descriptors
//! (Gionis, Indyk and Motwani, VLDB 1999), built while the map grows.

use std::collections::HashMap;

use pfd_vision::features::Descriptor;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg32;

use crate::map::KeyframeId;

/// Hash tables; a descriptor pair of distance 40 of 256 shares a bucket in at least one of them with probability 0.65.
const TABLES: usize = 16;
/// Bits that form the key of a table.
const KEY_BITS: usize = 16;
/// Buckets with more entries than this per keyframe hold descriptors that everything has; they say nothing.
const COMMON: usize = 8;

/// Inverted index from hashed descriptors to keyframes.
#[derive(Clone, Debug)]
pub struct PlaceIndex {
    /// For each table, which bits of the descriptor form the key.
    bits: Vec<[u8; KEY_BITS]>,
    buckets: Vec<HashMap<u16, Vec<Place>>>,
    /// The keyframe of each place; `None` where it was removed.
    keyframes: Vec<Option<KeyframeId>>,
}

/// Number of a keyframe in the index: small, so that scores are counted in a plain array.
type Place = u32;

impl PlaceIndex {
    /// An empty index; `seed` draws the bits of its tables.
    pub fn new(seed: u64) -> Self {
        let mut rng = Pcg32::seed_from_u64(seed);
        let mut order: Vec<u8> = (0..=u8::MAX).collect();
        let mut draw = || {
            order.shuffle(&mut rng);
            std::array::from_fn(|i| order[i])
        };
        let bits = (0..TABLES).map(|_| draw()).collect();
        Self { bits, buckets: vec![HashMap::new(); TABLES], keyframes: Vec::new() }
    }

    /// Adds a keyframe.
    pub fn insert<'a>(&mut self, id: KeyframeId, descriptors: impl Iterator<Item = &'a Descriptor>) {
        let place = self.keyframes.iter().position(Option::is_none).unwrap_or(self.keyframes.len());
        self.keyframes.resize(self.keyframes.len().max(place + 1), None);
        self.keyframes[place] = Some(id);
        for descriptor in descriptors {
            for (bits, buckets) in self.bits.iter().zip(&mut self.buckets) {
                buckets.entry(key(bits, descriptor)).or_default().push(place as Place);
            }
        }
    }

    /// Removes a keyframe, given the descriptors with which it was added.
    pub fn remove<'a>(&mut self, id: KeyframeId, descriptors: impl Iterator<Item = &'a Descriptor>) {
        let Some(place) = self.keyframes.iter().position(|k| *k == Some(id)) else { return };
        for descriptor in descriptors {
            for (bits, buckets) in self.bits.iter().zip(&mut self.buckets) {
                if let Some(bucket) = buckets.get_mut(&key(bits, descriptor)) {
                    bucket.retain(|other| *other as usize != place);
                }
            }
        }
        self.keyframes[place] = None;
    }

    /// Keyframes that look like an image with these descriptors, most alike first, with a score.
    ///
    /// A shared bucket counts the more, the fewer keyframes share it.
    pub fn query<'a>(&self, descriptors: impl Iterator<Item = &'a Descriptor>) -> Vec<(KeyframeId, f64)> {
        let mut scores = vec![0.0; self.keyframes.len()];
        let common = COMMON * self.keyframes.iter().flatten().count().max(1);
        for descriptor in descriptors {
            for (bits, buckets) in self.bits.iter().zip(&self.buckets) {
                let Some(bucket) = buckets.get(&key(bits, descriptor)).filter(|b| b.len() <= common) else { continue };
                let share = 1.0 / bucket.len() as f64;
                for place in bucket {
                    scores[*place as usize] += share;
                }
            }
        }
        let found = self.keyframes.iter().zip(scores).filter(|(_, score)| *score > 0.0);
        let mut sorted: Vec<_> = found.filter_map(|(id, score)| Some(((*id)?, score))).collect();
        sorted.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        sorted
    }
}

fn key(bits: &[u8; KEY_BITS], descriptor: &Descriptor) -> u16 {
    bits.iter().fold(0, |key, &bit| (key << 1) | ((descriptor.0[usize::from(bit / 64)] >> (bit % 64)) & 1) as u16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use slotmap::SlotMap;

    #[test]
    fn a_noisy_view_finds_its_place() {
        let mut rng = Pcg32::seed_from_u64(5);
        let mut ids: SlotMap<KeyframeId, ()> = SlotMap::with_key();
        let mut index = PlaceIndex::new(0);
        let places: Vec<(KeyframeId, Vec<Descriptor>)> = (0..50)
            .map(|_| (ids.insert(()), (0..200).map(|_| Descriptor(std::array::from_fn(|_| rng.random()))).collect()))
            .collect();
        for (id, descriptors) in &places {
            index.insert(*id, descriptors.iter());
        }
        let mut view = places[17].1.clone();
        for descriptor in &mut view {
            for _ in 0..30 {
                descriptor.0[rng.random_range(0..4)] ^= 1 << rng.random_range(0..64);
            }
        }
        let found = index.query(view.iter());
        assert_eq!(found[0].0, places[17].0);
        assert!(found[0].1 > 3.0 * found[1].1, "{:?}", &found[..2]);
        index.remove(places[17].0, places[17].1.iter());
        assert!(index.query(view.iter()).iter().all(|(id, _)| *id != places[17].0));
    }
}
