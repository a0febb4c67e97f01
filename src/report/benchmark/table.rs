//! Markdown tables with columns aligned for terminals.

/// Cell of a missing value.
pub(super) const NONE: &str = "–";

/// A number with its unit, if it exists.
pub(super) fn figure(value: Option<f64>, digits: usize, unit: &str) -> String {
    value.map_or(NONE.to_owned(), |value| format!("{value:.digits$}{unit}"))
}

/// A number without a unit, if it exists.
pub(super) fn number(value: Option<f64>, digits: usize) -> String {
    figure(value, digits, "")
}

/// A share in per cent, if it exists.
pub(super) fn percent(share: Option<f64>, digits: usize) -> String {
    figure(share.map(|share| 100.0 * share), digits, " %")
}

/// A table under construction.
pub(super) struct Table {
    rows: Vec<Vec<String>>,
}

impl Table {
    pub(super) fn new<S: Into<String>>(head: impl IntoIterator<Item = S>) -> Self {
        Self { rows: vec![head.into_iter().map(|cell| cell_text(cell.into())).collect()] }
    }

    pub(super) fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.rows.push(cells.into_iter().map(|cell| cell_text(cell.into())).collect());
    }

    pub(super) fn is_empty(&self) -> bool {
        self.rows.len() < 2
    }

    /// The first `num_left` columns are left-aligned, the others right-aligned.
    pub(super) fn render(&self, num_left: usize) -> String {
        let num_columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let cell = |row: &[String], k: usize| row.get(k).cloned().unwrap_or_default();
        let width = |k: usize| self.rows.iter().map(|row| cell(row, k).chars().count()).max().unwrap_or(0).max(3);
        let widths: Vec<usize> = (0..num_columns).map(width).collect();
        let line = |row: &[String]| {
            let padded = |k: usize| {
                let (text, width) = (cell(row, k), widths[k]);
                if k < num_left { format!(" {text:width$} |") } else { format!(" {text:>width$} |") }
            };
            "|".to_owned() + &(0..num_columns).map(padded).collect::<String>() + "\n"
        };
        let rule = |k: usize| {
            let dashes = "-".repeat(widths[k]);
            if k < num_left { format!(" {dashes} |") } else { format!(" {}: |", &dashes[1..]) }
        };
        let rule = "|".to_owned() + &(0..num_columns).map(rule).collect::<String>() + "\n";
        let (head, body) = self.rows.split_first().map_or((&[][..], &[][..]), |(head, body)| (&head[..], body));
        line(head) + &rule + &body.iter().map(|row| line(row)).collect::<String>()
    }
}

/// Text escaped for a cell.
fn cell_text(text: String) -> String {
    text.replace('|', "\\|").replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_cells_stay_cells() {
        let mut table = Table::new(["name", "m"]);
        assert!(table.is_empty());
        table.row(["a|b\nc", "0.25"]);
        table.row(["ä"]);
        let text = table.render(1);
        assert_eq!(text, "| name   |    m |\n| ------ | ---: |\n| a\\|b c | 0.25 |\n| ä      |      |\n");
    }
}
