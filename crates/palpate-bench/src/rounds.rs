//! Rows measured several times, in rounds over all of them.
//!
//! A machine that also does other work is slow for seconds at a time. If the runs of a row directly
//! followed each other, all of them could fall into one slow period. In rounds, slow periods affect
//! runs of all rows, and the middle run of each row is affected least.

/// Runs `once` for every row, then for every row again, and so on; returns the runs of each row.
///
/// `once` gets the number of the round, from 1.
pub(crate) fn measure<L, F, E>(
    rounds: u32,
    rows: &[L],
    mut once: impl FnMut(u32, &L) -> Result<F, E>,
) -> Result<Vec<Vec<F>>, E> {
    let mut runs: Vec<Vec<F>> = rows.iter().map(|_| Vec::new()).collect();
    for round in 1..=rounds {
        for (row, runs) in rows.iter().zip(&mut runs) {
            runs.push(once(round, row)?);
        }
    }
    Ok(runs)
}

/// For each row, the median over the rounds of its value divided by the mean of all rows: within a
/// round, the machine was about equally fast for all rows.
pub(crate) fn ratios_to_mean(rows: &[Vec<f64>]) -> Vec<f64> {
    let mean = |round: usize| rows.iter().map(|row| row[round]).sum::<f64>() / rows.len() as f64;
    let of = |row: &Vec<f64>| {
        let ratios: Vec<f64> =
            row.iter().enumerate().map(|(round, value)| value / mean(round)).collect();
        ratios[middle(&ratios)]
    };
    rows.iter().map(of).collect()
}

/// Index of the median of some numbers; of the lower one if two are in the middle.
pub(crate) fn middle(numbers: &[f64]) -> usize {
    let mut places: Vec<usize> = (0..numbers.len()).collect();
    places.sort_by(|&a, &b| numbers[a].total_cmp(&numbers[b]));
    places[(numbers.len() - 1) / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_has_as_many_runs_below_as_above() {
        assert_eq!(middle(&[7.0]), 0);
        assert_eq!(middle(&[3.0, 1.0, 2.0]), 2);
        assert_eq!(middle(&[9.0, 2.0]), 1);
        assert_eq!(middle(&[5.0, 4.0, 1.0, 3.0, 2.0]), 3);
    }

    #[test]
    fn a_slow_round_changes_no_ratio() {
        let ratios = ratios_to_mean(&[vec![1.0, 10.0, 1.0], vec![3.0, 30.0, 3.0]]);
        assert_eq!(ratios, [0.5, 1.5]);
    }

    #[test]
    fn every_round_takes_all_rows_before_the_next_begins() {
        let mut order = Vec::new();
        let runs = measure(2, &["a", "b"], |round, row| {
            order.push(format!("{row}{round}"));
            Ok::<_, ()>(order.len())
        });
        assert_eq!(runs, Ok(vec![vec![1, 3], vec![2, 4]]));
        assert_eq!(order, ["a1", "b1", "a2", "b2"]);
        assert_eq!(measure(3, &[1, 2], |_, &row| if row == 2 { Err(row) } else { Ok(()) }), Err(2));
    }
}
