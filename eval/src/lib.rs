//! Servo sessions: deflection, quadratic program, tables, figures and the report
