//! Samples worlds, writes them as Parquet datasets and reads them back
