//! Models in the formats of other tools: OCI image layouts and folders of the Hugging Face Hub.

mod card;
mod huggingface;
mod import;
mod oci;
