{{ about | commented("// ") }}
// The joint with the spring and the dashpot beside it, by rates; mass is the model's.
// Its equations are integrated in jbw's tests; no compiler of Modelica has seen them.
model Joint "Laws: {{ laws | join(', ') or 'none' }}; written by jbw {{ version }}"
  extends Modelica.Mechanics.Translational.Interfaces.PartialCompliantWithRelativeStates;
{% for one in parameters %}
  parameter Real {{ one.name }}(unit="{{ one.unit | modelica }}") = {{ one.value | number }} "{{ one.meaning }}";
{% endfor %}
{% for form in forms %}
  Real force_{{ form.name }}(unit="N/kg");
{% set part = "variables" %}
{% include form.file %}
{% endfor %}
equation
{% for form in forms %}
{% set part = "equations" %}
{% include form.file %}
{% endfor %}
  f = spring*s_rel + dashpot*v_rel{% for form in forms %} + mass*force_{{ form.name }}{% endfor %};
end Joint;
