//! Names that look like a slip of others.

/// Names that differ in more letters are not a spelling mistake.
const MAX_DISTANCE: usize = 3;
/// Nor are short names that differ in most of their letters.
const LETTERS_PER_SLIP: usize = 3;

/// The known name that is most like `name`, if `name` may be a slip of it.
pub fn similar<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let nearest = known.into_iter().map(|other| (edit_distance(name, other), other)).min();
    let is_slip = |distance: usize| distance <= MAX_DISTANCE.min(name.len() / LETTERS_PER_SLIP).max(1);
    nearest.filter(|(distance, _)| is_slip(*distance)).map(|(_, other)| other)
}

/// Levenshtein distance in bytes.
fn edit_distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.bytes().enumerate() {
            let substituted = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_few_letters() {
        let known = ["count", "fx"];
        assert_eq!(similar("cuont", known), None, "two of five letters");
        assert_eq!(similar("counts", known), Some("count"));
        assert_eq!(similar("fy", known), Some("fx"));
        assert_eq!(similar("fps", known), None);
    }
}
