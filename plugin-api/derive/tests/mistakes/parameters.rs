use plugin_api_derive::ParamSet;

#[derive(ParamSet)]
struct Wrong {
    no_default: f64,
    #[param(default = 1.0, minimum = 0.0)]
    unknown_word: f64,
    #[param(default = 1.0, hard = 0.0..1.0)]
    open_range: f64,
    #[param(default = 1.0, unit = "m/s")]
    no_unit: f64,
    #[param(default = 1.0, id = "Not Kebab")]
    no_id: f64,
    #[param(default = 1.0, default = 2.0)]
    twice: f64,
    #[param(default = 1.0)]
    size: f64,
    #[param(default = 1.0, id = "size")]
    same_id: f64,
    #[param(point, direction, default = [0.0; 3])]
    two_kinds: [f64; 3],
}

#[derive(ParamSet)]
struct Unnamed(f64);

fn main() {}
