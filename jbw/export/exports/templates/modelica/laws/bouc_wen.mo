{% if part == "variables" %}
  Real z(unit="N/kg", start=0, fixed=true) "force of Bouc-Wen's law";
{% else %}
  der(z) = alpha*v_rel - gamma*abs(v_rel)*z - delta*v_rel*abs(z);
  force_bouc_wen = z;
{% endif %}
