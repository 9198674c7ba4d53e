{% set count = form.num // 2 %}
{% if part == "variables" %}
{% for i in range(1, count + 1) %}
{% if i > 1 %}
  parameter Real slip_{{ i }}(unit="m") = slip_{{ i - 1 }}*slip_ratio_{{ i }} "displacement at which slider {{ i }} slips";
{% endif %}
  Real x_{{ i }}(unit="m", start=0, fixed=true) "stretch of slider {{ i }}";
{% endfor %}
{% else %}
{% for i in range(1, count + 1) %}
  der(x_{{ i }}) = if (x_{{ i }} >= slip_{{ i }} and v_rel > 0) or (x_{{ i }} <= -slip_{{ i }} and v_rel < 0) then 0 else v_rel;
{% endfor %}
  force_jenkins = {% for i in range(1, count + 1) %}{{ " + " if i > 1 }}stiffness_{{ i }}*x_{{ i }}{% endfor %};
{% endif %}
