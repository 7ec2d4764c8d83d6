use super::*;

const CSV: &str = "time_s,count,k_n_per_m,verdict,force_q30\n0,1,2000,stable,\n0.0001,-2,2e3,,7\n";

#[test]
fn a_columns_kind_is_that_of_its_unit_or_of_its_cells() {
    let table = Table::of_csv(CSV);
    assert_eq!(table.rows, 2);
    let names: Vec<_> =
        table.columns.iter().map(|c| (c.name.as_str(), c.unit.as_deref())).collect();
    let [s, n_per_m, q30] = ["s", "N/m", "2^-30 of full scale"].map(Some);
    let expected = [
        ("time_s", s),
        ("count", None),
        ("k_n_per_m", n_per_m),
        ("verdict", None),
        ("force_q30", q30),
    ];
    assert_eq!(names, expected);
    let cells: Vec<_> = table.columns.into_iter().map(|column| column.cells).collect();
    assert_eq!(cells[0], Cells::Numbers(vec![Some(0.0), Some(0.0001)]));
    assert_eq!(cells[1], Cells::Integers(vec![Some(1), Some(-2)]));
    assert_eq!(cells[2], Cells::Numbers(vec![Some(2000.0); 2]));
    assert_eq!(cells[3], Cells::Words(vec![Some("stable".into()), None]));
    assert_eq!(cells[4], Cells::Integers(vec![None, Some(7)]));
}

#[test]
fn an_area_is_a_float_even_if_it_is_whole() {
    let table = Table::of_csv("area\n5\n");
    assert_eq!(table.columns[0].cells, Cells::Numbers(vec![Some(5.0)]));
}

#[test]
fn a_units_words_are_those_at_the_end_of_the_name() {
    for (name, unit) in [
        ("area_n2_s_per_m2", "N^2 s/m^2"),
        ("area_n2_m2_s_per_rad2", "N^2 m^2 s/rad^2"),
        ("k_n_m_per_rad", "N m/rad"),
        ("speed_rad_per_s", "rad/s"),
        ("inertia_kg_m2", "kg m^2"),
        ("reserve_j", "J"),
    ] {
        assert_eq!(Column::of(name, &[]).unit.as_deref(), Some(unit));
    }
}

#[test]
fn only_what_has_times_becomes_mcap() {
    let refused = Format::of(Path::new("a.mcap"), Kind::Rows).unwrap_err().to_string();
    assert!(refused.contains("allowed endings are .csv and .parquet"), "{refused}");
    assert_eq!(Format::of(Path::new("a.txt"), Kind::Rows).unwrap(), Format::Csv);
    let format = Format::of(Path::new("a.parquet"), Kind::Rows);
    assert_eq!(format.is_ok(), cfg!(feature = "open-files"));
}

#[cfg(feature = "open-files")]
mod open {
    use ::parquet::{
        file::reader::{FileReader as _, SerializedFileReader},
        record::RowAccessor as _,
    };

    use super::*;

    fn about(kind: Kind) -> About {
        About { kind, manifest: r#"{"command":"hit"}"#.into() }
    }

    #[test]
    fn parquet_has_every_value_the_units_and_the_manifest() {
        let bytes = bytes(Format::Parquet, CSV, &about(Kind::Rows)).unwrap();
        let file = SerializedFileReader::new(::bytes::Bytes::from(bytes)).unwrap();
        let pairs = file.metadata().file_metadata().key_value_metadata().unwrap();
        let of = |key: &str| pairs.iter().find(|pair| pair.key == key).unwrap().value.clone();
        assert_eq!(of("zwidth.manifest").unwrap(), r#"{"command":"hit"}"#);
        assert!(of("zwidth.units").unwrap().contains(r#""k_n_per_m":"N/m""#));
        let rows: Vec<_> = file.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[1].get_double(0).unwrap(), 0.0001);
        assert_eq!(rows[1].get_long(1).unwrap(), -2);
        assert_eq!(rows[0].get_string(3).unwrap(), "stable");
        assert!(rows[0].get_long(4).is_err(), "an empty cell is null");
        assert_eq!(rows[1].get_long(4).unwrap(), 7);
    }

    #[test]
    fn mcap_has_a_message_at_the_time_of_each_row() {
        let times = "sample,position_counts,name\n10000,3,\n20001,-4,x\n";
        let moments = about(Kind::Moments { rate_hz: 10_000.0 });
        for (text, expected) in [(CSV, [0, 100_000]), (times, [1_000_000_000, 2_000_100_000])] {
            let bytes = bytes(Format::Mcap, text, &moments).unwrap();
            let messages: Vec<_> =
                ::mcap::read::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
            assert_eq!(messages.iter().map(|m| m.log_time).collect::<Vec<_>>(), expected);
            assert_eq!(messages[0].channel.schema.as_ref().unwrap().encoding, "jsonschema");
            let last: serde_json::Value = serde_json::from_slice(&messages[1].data).unwrap();
            assert_eq!(
                last.as_object().unwrap().len(),
                text.lines().next().unwrap().split(',').count()
            );
        }
        assert!(bytes(Format::Mcap, "a,b\n1,2\n", &moments).is_err(), "no time");
    }
}
