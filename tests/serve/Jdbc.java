import java.io.IOException;
import java.io.PrintStream;
import java.nio.charset.StandardCharsets;
import java.sql.Array;
import java.sql.Connection;
import java.sql.DatabaseMetaData;
import java.sql.DriverManager;
import java.sql.ResultSet;
import java.sql.ResultSetMetaData;
import java.sql.SQLException;
import java.sql.Statement;
import java.time.LocalDateTime;
import java.time.OffsetDateTime;
import java.time.format.DateTimeFormatter;
import java.util.ArrayList;
import java.util.HexFormat;
import java.util.List;

/**
 * Asks a served map by JDBC what standard input has, queries divided by zeros, and prints an answer a line, as JSON:
 * names and types of its columns and its rows, or an error. The last lines have what the driver tells of the table lanes: its key, its
 * indexes, its columns.
 *
 * <pre>java -cp postgresql.jar Jdbc.java URL</pre>
 */
public final class Jdbc {
    private static final PrintStream OUT = new PrintStream(System.out, false, StandardCharsets.UTF_8);

    public static void main(String[] arguments) throws IOException, SQLException {
        String asked = new String(System.in.readAllBytes(), StandardCharsets.UTF_8);
        try (Connection connection = DriverManager.getConnection(arguments[0], "me", "")) {
            for (String query : asked.split("\0")) {
                try (Statement statement = connection.createStatement();
                        ResultSet rows = statement.executeQuery(query)) {
                    OUT.println(answer(rows));
                } catch (SQLException error) {
                    OUT.println("{\"error\":" + text(error.toString()) + "}");
                }
            }
            DatabaseMetaData told = connection.getMetaData();
            tell(() -> told.getPrimaryKeys(null, "public", "lanes"));
            tell(() -> told.getIndexInfo(null, "public", "lanes", true, true));
            tell(() -> told.getColumns(null, null, "lanes", null));
        }
        OUT.flush();
    }

    private interface Asked {
        ResultSet rows() throws SQLException;
    }

    private static void tell(Asked asked) {
        try (ResultSet rows = asked.rows()) {
            OUT.println(answer(rows));
        } catch (SQLException error) {
            OUT.println("{\"error\":" + text(error.toString()) + "}");
        }
    }

    private static String answer(ResultSet rows) throws SQLException {
        ResultSetMetaData columns = rows.getMetaData();
        List<String> names = new ArrayList<>();
        List<String> types = new ArrayList<>();
        for (int column = 1; column <= columns.getColumnCount(); column++) {
            names.add(text(columns.getColumnLabel(column)));
            types.add(text(columns.getColumnTypeName(column)));
        }
        List<String> all = new ArrayList<>();
        while (rows.next()) {
            List<String> row = new ArrayList<>();
            for (int column = 1; column <= columns.getColumnCount(); column++) {
                row.add(value(rows, column, columns.getColumnTypeName(column)));
            }
            all.add(list(row));
        }
        return "{\"names\":" + list(names) + ",\"types\":" + list(types) + ",\"rows\":" + list(all) + "}";
    }

    private static String value(ResultSet rows, int column, String type) throws SQLException {
        if (rows.getObject(column) == null) {
            return "null";
        }
        return switch (type) {
            case "timestamptz" -> text(DateTimeFormatter.ISO_OFFSET_DATE_TIME.format(
                    rows.getObject(column, OffsetDateTime.class)));
            case "timestamp" -> text(DateTimeFormatter.ISO_LOCAL_DATE_TIME.format(
                    rows.getObject(column, LocalDateTime.class)));
            default -> json(rows.getObject(column));
        };
    }

    private static String json(Object value) throws SQLException {
        if (value instanceof Array array) {
            return json(array.getArray());
        }
        if (value instanceof Object[] values) {
            List<String> all = new ArrayList<>();
            for (Object one : values) {
                all.add(json(one));
            }
            return list(all);
        }
        if (value instanceof byte[] bytes) {
            return text(HexFormat.of().formatHex(bytes));
        }
        return value == null || value instanceof Number || value instanceof Boolean
                ? String.valueOf(value)
                : text(value.toString());
    }

    private static String list(List<String> values) {
        return "[" + String.join(",", values) + "]";
    }

    private static String text(String value) {
        if (value == null) {
            return "null";
        }
        StringBuilder text = new StringBuilder("\"");
        for (char letter : value.toCharArray()) {
            if (letter == '"' || letter == '\\' || letter < ' ') {
                text.append(String.format("\\u%04x", (int) letter));
            } else {
                text.append(letter);
            }
        }
        return text.append('"').toString();
    }
}
