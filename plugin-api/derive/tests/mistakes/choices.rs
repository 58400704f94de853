use plugin_api_derive::Choice;

#[derive(Choice, Clone, Copy)]
enum WithFields {
    Twist { angle: f64 },
}

#[derive(Choice, Clone, Copy)]
enum UnknownWord {
    #[choice(name = "Bend")]
    Bend,
}

#[derive(Choice, Clone, Copy)]
enum Nothing {}

#[derive(Choice, Clone, Copy)]
struct NoEnum;

fn main() {}
