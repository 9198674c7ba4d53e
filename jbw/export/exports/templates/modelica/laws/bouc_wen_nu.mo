{% if part == "variables" %}
  Real w(unit="m", start=0, fixed=true) "stretch of Bouc-Wen's spring";
{% else %}
  der(w) = v_rel - (nu_softening*v_rel + nu_opening*abs(v_rel)*sign(w))*(abs(w)/1e-3)^nu;
  force_bouc_wen_nu = nu_stiffness*w;
{% endif %}
