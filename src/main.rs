//! flowservo
fn main(){}
